# SPDX-License-Identifier: BSD-3-Clause
"""A verdict is shown in a line, a table with standard deviations, and a picture."""

import pytest

from piezo_identification.diagnosis.comparison.criteria import Reason, Undecided
from piezo_identification.diagnosis.verdict import Verdict, extended_model
from piezo_models import CreepDynamics, ElectricVibrationDynamics, PreisachModel, StageModel
from piezo_models.identified_model import IdentifiedModel
from piezo_recorder.reading.memory import recording_of

MODEL = StageModel(PreisachModel(0.0, 1.0, [[0.0]]), CreepDynamics(), ElectricVibrationDynamics())


def verdict(effects, model=MODEL):
    return Verdict(
        verdict="explained", effects=effects, model=model,
        before={"rms_um": 0.02, "e_y_percent": 1.5}, after={"rms_um": 0.004, "e_y_percent": 0.3},
        noise_floor_um=0.003, holdout={"source": "run", "samples": 90},
        undecided={"creep": Undecided(Reason.NOT_EXCITED, "the recording is too short")}, left="",
        reversed=[], left_out=[], ceiling=None)


FOUND = [{"name": "delay", "parameters": {"delay_s": 4e-5}, "error_reduction_percent": 80.0,
          "standard_deviations": {"delay_s": 2e-6}},
         {"name": "periodic_disturbance", "parameters": {"amplitudes_um": (0.1, 0.2)},
          "error_reduction_percent": 10.0}]


def test_table_holds_errors_parameters_and_deviations():
    table = verdict(FOUND).summary()
    cells = {row[0]: row[1:3] for row in table.rows}
    assert cells["RMS error, before"][0] == pytest.approx(20.0)
    assert cells["delay, delay_s"] == (4e-5, 2e-6)
    assert cells["periodic_disturbance, amplitudes_um 2"] == (0.2, None)
    assert "creep cannot be decided: the recording is too short" in table.notes


def test_line_names_the_effects_and_both_errors():
    assert repr(verdict(FOUND)) == ("<Verdict: explained by delay and periodic_disturbance, "
                                    "20 nm RMS before, 4 nm after, 3 nm noise>")
    assert "explained, 20 nm" in repr(verdict([]))
    assert "by what behaves like delay, 20 nm" in repr(verdict([FOUND[0] | {"stand_in": True}]))


def test_picture_has_a_bar_for_each_error_and_effect():
    errors, effects = verdict(FOUND).plot().axes
    assert sorted(bar.get_width() for bar in errors.patches) == pytest.approx([3.0, 4.0, 20.0])
    assert [bar.get_width() for bar in effects.patches] == [10.0, 80.0]
    assert verdict([]).plot().axes[1].texts[0].get_text() == "no effect is named"


def test_extended_model_keeps_where_it_was_found_even_if_that_was_no_file():
    recording = recording_of({"time_s": [0.0, 1.0], "voltage_v": [0.0, 1.0],
                              "displacement_um": [0.0, 1.0]}, name="frame")
    identified = IdentifiedModel(MODEL, (0.0, 1.0))
    other = StageModel(MODEL.hysteresis, MODEL.creep, ElectricVibrationDynamics(1e-3))
    extended = extended_model(identified, verdict(FOUND, other), [recording])
    assert extended.model is other
    assert extended.recordings == [{"path": "frame", "sha256": recording.sha256}]
    assert extended_model(identified, verdict([]), [recording]) is identified
