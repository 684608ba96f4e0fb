# SPDX-License-Identifier: BSD-3-Clause
"""A play is taken out of the hysteresis that shows both: the loops stay."""

import numpy as np
import pytest

from piezo_models.effects.backlash import without_play
from piezo_models.hysteresis.preisach import PreisachModel

LEVELS, SPAN_V = 80, 100.0


def stage():
    density = np.tril(np.full((LEVELS, LEVELS), 2e-4))
    return PreisachModel(0.0, SPAN_V, density, 0.0, np.full(LEVELS, 0.08))


def played(displacement_um, width_um):
    """Follow a displacement that came from far above with a play, written as a loop."""
    trailing_um, last = np.empty_like(displacement_um), displacement_um[0] + 0.5 * width_um
    for n, position in enumerate(displacement_um):
        last = min(max(last, position - 0.5 * width_um), position + 0.5 * width_um)
        trailing_um[n] = last
    return trailing_um


def turning(seed):
    """Return a voltage with random turning points, from the lowest one to the highest first."""
    turns_v = np.random.default_rng(seed).uniform(0.0, SPAN_V, 40)
    turns_v = np.concatenate([[0.0, SPAN_V], turns_v])
    return np.interp(np.linspace(0.0, turns_v.size - 1.0, 4000), np.arange(turns_v.size), turns_v)


def seen(hysteresis, width_um):
    """Return the hysteresis that shows what a play leaves of another one, by its loops."""
    levels_v = hysteresis.levels_v
    motion_um = np.maximum(hysteresis.everett_um(levels_v[:, None], levels_v) - width_um, 0.0)
    cells = (motion_um[1:, :-1] - motion_um[:-1, :-1] - motion_um[1:, 1:] + motion_um[:-1, 1:])
    cell_v = hysteresis.cell_width_v
    return PreisachModel(0.0, SPAN_V, np.tril(cells, -1) / cell_v**2, 0.0,
                         np.diagonal(motion_um, -1) / cell_v)


@pytest.mark.parametrize("width_um", [0.3, 1.0, 2.5])
def test_the_hysteresis_ahead_of_a_play_is_found_back(width_um):
    hysteresis, voltage_v = stage(), turning(1)
    ahead_um = hysteresis.simulate(voltage_v)
    both = seen(hysteresis, width_um)
    measured_um = played(ahead_um, width_um)
    # Loops alone do not tell the two apart, within the grid.
    cell_um = np.ptp(ahead_um) / LEVELS
    assert np.std(both.simulate(voltage_v) - measured_um) < 0.2 * cell_um
    found = without_play(both, width_um)
    assert np.std(found.simulate(voltage_v) - ahead_um) < 0.2 * cell_um
    # A small motion that both do not show has the gain at which the play is taken up.
    assert np.mean(found.reversible_um_per_v) == pytest.approx(0.08, rel=0.1)


def test_no_play_leaves_the_hysteresis_as_it_is():
    hysteresis, voltage_v = stage(), turning(2)
    same = without_play(hysteresis, 1e-9).simulate(voltage_v)
    assert same == pytest.approx(hysteresis.simulate(voltage_v), abs=0.01)
