# SPDX-License-Identifier: BSD-3-Clause
"""Relays that never switch back: their sum over the highest voltage so far, and its file."""

from dataclasses import replace

import numpy as np
import pytest

from piezo_models.hysteresis.first_rise import FirstRise
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.identified_model import IdentifiedModel
from piezo_models.model_file import load_model, save_model

FIRST_RISE = FirstRise((0.0, 40.0, 100.0), (0.0, 1.0, 4.0))


def test_it_is_what_a_preisach_plane_below_the_voltages_adds():
    """Relays with lower thresholds below all voltages, as a wider Preisach model has them."""
    cells = 30
    density = np.zeros((cells, cells))
    density[10:, :10] = np.linspace(1e-3, 3e-3, 20)[:, None]
    wider = PreisachModel(-50.0, 100.0, density)
    edges_v = np.linspace(0.0, 100.0, 21)
    first_rise = FirstRise(
        tuple(edges_v), tuple(wider.everett_um(edges_v, np.full(21, -50.0))))
    voltage_v = np.concatenate([np.linspace(0, 63, 50), np.linspace(63, 0, 50),
                                np.linspace(0, 100, 80), np.linspace(100, 0, 20)])
    assert first_rise.simulate(voltage_v, 0.0) == pytest.approx(
        wider.simulate(voltage_v) - first_rise.whole_um, abs=1e-12)


def test_a_cycled_stage_lacks_nothing():
    assert not FIRST_RISE.simulate(np.linspace(0.0, 100.0, 11)).any()


@pytest.mark.parametrize(("voltages_v", "remanence_um"), [
    ((0.0, 1.0), (0.0,)), ((0.0,), (0.0,)), ((0.0, 0.0), (0.0, 1.0)), ((0.0, 1.0), (0.0, -1.0)),
    ((0.0, 1.0), (0.5, 1.0))])
def test_what_is_no_remanence_is_refused(voltages_v, remanence_um):
    with pytest.raises(ValueError, match="; give"):
        FirstRise(voltages_v, remanence_um)


def test_the_file_keeps_it_and_a_stage_counts_as_cycled(stage, tmp_path):
    model = replace(stage, first_rise=FIRST_RISE)
    save_model(tmp_path / "m.json", IdentifiedModel(model, (-20.0, 120.0)))
    loaded = load_model(tmp_path / "m.json").model
    assert loaded.first_rise == FIRST_RISE
    voltage_v = np.linspace(0.0, 90.0, 50)
    assert np.array_equal(loaded.simulate(voltage_v, 1e-3), stage.simulate(voltage_v, 1e-3))
    lacking_um = loaded.simulate(voltage_v, 1e-3, loaded.memory(highest_v=0.0)) - stage.simulate(
        voltage_v, 1e-3)
    # At rest the creep is over.
    at_rest = np.prod(np.divide(stage.creep.zeros_rad_per_s, stage.creep.poles_rad_per_s))
    assert lacking_um[0] == pytest.approx(-4.0 * at_rest)
    assert 0.3 * lacking_um[0] < lacking_um[-1] < 0.0
