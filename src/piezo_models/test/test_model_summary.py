# SPDX-License-Identifier: BSD-3-Clause
"""A model is shown in a line, in a table with Hz and standard deviations, and in a picture."""

from dataclasses import replace

import numpy as np
import pytest

from piezo_models.cascade import StageModel
from piezo_models.effects.delay import Delay
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.identified_model import IdentifiedModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_models.model_summary import main_results, visited_fraction

DEVIATIONS = {
    "creep": {"poles_rad_per_s": [0.001, 0.002, 0.003, 0.004, 0.005]},
    "dynamics": {"time_constant_s": 1e-6, "mode_frequencies_rad_per_s": [6.283185307, np.inf]},
    "effects": [{"delay_s": 2e-6}],
}


@pytest.fixture
def identified(stage):
    extended = replace(stage, effects=(Delay(40e-6),))
    visited = np.zeros((20, 20), dtype=bool)
    visited[np.tril_indices(20)] = True
    visited[10:, :10] = False
    return IdentifiedModel(extended, (-20.0, 120.0), uncertainties=DEVIATIONS, visited=visited,
                           errors={"e_y_percent": 0.5, "held_out": {"before": 2.0}})


def rows_of(shown):
    return {row[0]: dict(zip(shown.summary().heads, row, strict=True))
            for row in shown.summary().rows}


def test_rows_hold_hz_beside_rad_per_s_with_both_deviations(identified):
    mode = rows_of(identified)["mode frequency 1"]
    assert mode["value"] == 2846.0 and mode["unit"] == "rad/s"
    assert mode["in Hz"] == pytest.approx(2846.0 / (2.0 * np.pi))
    assert mode["std. dev. (Hz)"] == pytest.approx(1.0)
    assert rows_of(identified)["mode frequency 2"]["std. dev."] is None


def test_rows_hold_every_component_effect_and_error(identified):
    rows = rows_of(identified)
    assert rows["creep pole 5"]["std. dev."] == 0.005
    assert rows["electric time constant"]["value"] == pytest.approx(0.49)
    assert rows["electric time constant"]["std. dev."] == pytest.approx(1e-3)
    assert rows["delay, delay_s"]["std. dev."] == 2e-6
    assert rows["error held_out.before"]["value"] == 2.0
    assert rows["Preisach plane visited"]["value"] == pytest.approx(50.0)


def test_main_results_hold_the_extreme_creep_and_all_other_parameters(identified):
    shown = main_results(identified)
    rows = {row[0]: row for row in shown.rows}
    poles = np.array(identified.model.creep.poles_rad_per_s)
    deviations = np.array(DEVIATIONS["creep"]["poles_rad_per_s"])
    assert rows["creep, pairs of a pole and a zero"][1] == 5
    for name, index in (("fastest", poles.argmax()), ("slowest", poles.argmin())):
        _, value, deviation, unit, *_ = rows[f"creep, {name} time constant"]
        assert (value, unit) == (pytest.approx(1.0 / poles[index]), "s")
        assert deviation == pytest.approx(deviations[index] / poles[index] ** 2)
    assert {"electric time constant", "mode frequency 1", "delay, delay_s"} <= rows.keys()
    assert not any(name.startswith(("creep pole", "creep zero")) for name in rows)
    assert shown.title.endswith("from -20 to 120 V, 50 % of the Preisach plane visited")


def test_main_results_of_a_line_are_its_title_alone():
    line = PreisachModel.line(0.0, 10.0, 2.0)
    shown = main_results(IdentifiedModel(
        StageModel(line, CreepDynamics(), ElectricVibrationDynamics()), (0.0, 10.0)))
    assert repr(shown) == "identified: 20 um from 0 to 10 V, without hysteresis"


def test_coverage_counts_half_cells_on_the_diagonal():
    visited = np.eye(4, dtype=bool)
    assert visited_fraction(visited) == pytest.approx(4 * 0.5 / 8.0)


def test_lines_are_short(identified):
    assert repr(identified.model) == ("<StageModel: -20 to 120 V, "
                                      f"{np.ptp(identified.model.hysteresis.output_range_um):.4g} "
                                      "um, 5 creep poles, modes at 453, 781.3 Hz, delay>")
    assert len(repr(identified)) < 160 and "\n" not in repr(identified.model.hysteresis)


def test_picture_hatches_what_was_not_visited(identified):
    shown, whole = identified.plot(), identified.model.plot()
    hatches = [sum(bool(getattr(part, "hatches", None)) for part in figure.axes[0].collections)
               for figure in (shown, whole)]
    assert hatches == [1, 0]
    gain = next(one for one in shown.axes if one.get_ylabel() == "gain (um/um)")
    frequency_hz, drawn = gain.lines[0].get_data()
    np.testing.assert_allclose(drawn, np.abs(identified.model.response(frequency_hz)))
    assert frequency_hz[-1] > 4909.0 / (2.0 * np.pi)
