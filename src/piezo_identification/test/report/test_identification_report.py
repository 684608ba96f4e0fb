# SPDX-License-Identifier: BSD-3-Clause
"""The page of an identification: its pictures are of the recordings as the model was tested."""

from pathlib import Path

import numpy as np
import pytest

from piezo_common.picture_style import new_figure
from piezo_identification.conditioning.row_alignment import rows_read_at_start
from piezo_identification.experiments import catalogue as experiments
from piezo_identification.identification.notes import Detail
from piezo_identification.prediction import unseen_errors
from piezo_identification.report import identification_report
from piezo_identification.report.identification_report import identification_page
from piezo_models.identified_model import IdentifiedModel


def test_what_was_tried_stands_last_with_its_pictures(plant, page_parts, tmp_path):
    def drawn():
        figure = new_figure()
        figure.subplots().plot([0.0, 1.0], [0.0, 1.0])
        return figure

    identified = IdentifiedModel(
        plant, (-20.0, 120.0),
        visited=np.ones(plant.hysteresis.density_um_per_v2.shape, dtype=bool))
    page = tmp_path / "page.html"
    page.write_text(identification_page(identified, {}, Path("model.json"), details=[
        Detail("order of the creep:\n0 1 2", drawn), Detail("start of the creep: at rest")]))
    assert page_parts(page).is_picture("Order of the creep")
    assert "<p>start of the creep: at rest.</p>" in page.read_text().partition("What was tried")[2]


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
