# SPDX-License-Identifier: BSD-3-Clause
"""Experiments of several axes move each alone or all at once, within the limits of each."""

import numpy as np
import pytest

from piezo_identification.experiments.catalogue import named_experiment
from piezo_identification.experiments.several_axes import axes_experiments, orthogonal_multisines
from piezo_identification.experiments.stage_limits import StageLimits

LIMITS = {"x": StageLimits(), "y": StageLimits(voltage_min_v=0.0, voltage_max_v=60.0,
                                               rest_voltage_v=5.0)}


@pytest.mark.parametrize("axes", ["xy", "xyz"])
def test_spectra_of_the_axes_are_orthogonal_at_every_line(axes):
    limits = {axis: StageLimits() for axis in axes}
    multisines = orthogonal_multisines(limits, period_s=0.02)
    assert len(multisines) == 2 * len(axes)
    for block in (multisines[:len(axes)], multisines[len(axes):]):
        lines = np.fft.rfft([each.voltage_v for each in block], axis=1)[:, 1:60]
        products = np.einsum("rfi,rfj->fij", lines, lines.conj())
        unit = products / products[:, :1, :1]
        assert np.allclose(unit, np.eye(len(axes)), atol=1e-9)


def test_multisines_lie_about_the_middle_of_each_range_and_tell_what_settles():
    for each in axes_experiments("multisine", LIMITS):
        assert np.allclose(each.voltage_v.mean(axis=0), [50.0, 30.0])
        assert np.allclose(each.voltage_v.std(axis=0), [4.2, 1.8])
        assert each.parameters()["settling_repeats"] == 2 and each.repeats == 4
        assert len(each.voltage_v) % 40 == 0


def test_experiment_of_one_axis_is_played_by_each_in_turn_while_the_others_rest():
    x, y = axes_experiments("dynamics", LIMITS)
    assert (x.name, y.name) == ("dynamics_x", "dynamics_y")
    assert np.array_equal(x.voltage_v[:, 0], named_experiment("dynamics", LIMITS["x"]).voltage_v)
    assert np.array_equal(y.voltage_v[:, 1], named_experiment("dynamics", LIMITS["y"]).voltage_v)
    assert np.all(x.voltage_v[:, 1] == 5.0) and np.all(y.voltage_v[:, 0] == 0.0)
    assert x.duration_s == pytest.approx(2.0) and "settling_repeats" not in x.parameters()


def test_validation_moves_all_axes_none_as_another():
    both, = axes_experiments("validation", LIMITS)
    assert both.name == "validation" and both.voltage_v.shape[1] == 2
    assert abs(np.corrcoef(both.voltage_v.T)[0, 1]) < 0.5
    assert np.all(np.ptp(both.voltage_v, axis=0) > [120.0, 50.0])


def test_waveform_that_one_axis_would_not_play_is_refused_with_its_name():
    slow = {"x": StageLimits(), "y": StageLimits(slew_limit_v_per_s=1.0e4)}
    with pytest.raises(ValueError, match="y: experiment 'multisine_1' needs a slew of"):
        axes_experiments("multisine", slow)


def test_experiment_in_feedback_is_refused_with_the_axes():
    with pytest.raises(ValueError, match="'relay' acts in feedback, .*: this one has x, y"):
        axes_experiments("relay", LIMITS)
    with pytest.raises(ValueError, match="unknown experiment 'warp'"):
        axes_experiments("warp", LIMITS)
