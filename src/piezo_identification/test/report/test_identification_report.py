# SPDX-License-Identifier: BSD-3-Clause
"""The page of an identification: its pictures are of the recordings as the model was tested."""

from pathlib import Path

import numpy as np
import pytest

from piezo_identification.conditioning.row_alignment import rows_read_at_start
from piezo_identification.experiments import catalogue as experiments
from piezo_identification.prediction import unseen_errors
from piezo_identification.report import identification_report
from piezo_identification.report.identification_report import identification_page
from piezo_models.identified_model import IdentifiedModel


def test_the_picture_of_the_validation_has_the_error_that_its_table_has(
        plant, play, monkeypatch):
    read_late = rows_read_at_start(play(experiments.validation(arc_s=0.02, tones_s=0.2), 1), -1.0)
    errors = unseen_errors(plant, rows_read_at_start(read_late, 1.0))
    drawn = []
    monkeypatch.setattr(identification_report, "prediction_pictures",
                        lambda prediction: drawn.append(prediction) or [])
    identified = IdentifiedModel(
        plant, (-20.0, 120.0), errors=errors,
        visited=np.ones(plant.hysteresis.density_um_per_v2.shape, dtype=bool),
        rows={"validation": {"read_at_samples": 1.0, "standard_deviation_s": 1e-7}})
    identification_page(identified, {"validation": read_late}, Path("model.json"))
    assert drawn[0].e_y_percent() == pytest.approx(errors["e_y_percent"], rel=1e-3)
