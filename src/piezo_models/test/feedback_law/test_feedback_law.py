# SPDX-License-Identifier: BSD-3-Clause
"""A feedback law beside python-control, beside a loop written out, and where it must be refused."""

import subprocess
import sys
from dataclasses import replace

import control
import numpy as np
import pytest

from piezo_models.feedback_law.feedback_law import (
    DeclaredPlant,
    FeedbackLaw,
    FeedbackLawError,
    InverseHysteresis,
    LinearBlock,
)
from piezo_models.feedback_law.law_check import check_law
from piezo_models.feedback_law.running_inverse import PLAYED
from piezo_models.feedback_law.running_law import RunningLaw
from piezo_models.hysteresis.preisach import PreisachModel

SAMPLES, CLOCK_S = 10, 1e-4
HZ = 2 * np.pi


def second_order(frequency_hz=150.0, damping=0.3):
    """Return the sampled linear plant, by python-control."""
    w = HZ * frequency_hz
    return control.c2d(control.ss(control.tf([w**2], [1, 2 * damping * w, w**2])), CLOCK_S)


def block(system):
    return LinearBlock.of(system.A, system.B, system.C, system.D)


def integral_law(gain, plant=None, **changes):
    """Return the law u = gain * sum of the mean errors."""
    plant = plant or second_order()
    integrator = LinearBlock.of([1.0], [gain], [1.0], [gain])
    return FeedbackLaw(integrator, np.array([0.5]), 10.0, np.zeros(1), np.zeros(0),
                       DeclaredPlant(block(plant), np.array([0.8, 1.0, 1.2])), **changes)


def closed(law, gain_um_per_v, ticks, disturbance_um=1.0, plant=None):
    """Return the displacement of a loop that is written out, sample by sample, shape (N,)."""
    plant, running = plant or second_order(), RunningLaw(law, SAMPLES)
    state, measured_um = np.zeros((plant.nstates, 1)), []
    for _ in range(ticks * SAMPLES // running.samples_at_once):
        voltage_v = np.zeros(running.samples_at_once)
        voltage_v += running.begin(voltage_v)
        part_um = []
        for value_v in voltage_v:
            part_um.append((plant.C @ state).item() + disturbance_um)
            state = plant.A @ state + plant.B * gain_um_per_v * value_v
        running.take(np.array(part_um))
        measured_um += part_um
    return np.array(measured_um)


def critical_gain(delay_ticks):
    """Find where the loop with the largest gain of the hysteresis begins to grow, by playing it."""
    low, high = 1e-3, 10.0
    for _ in range(15):  # to a thousandth
        middle = (low * high) ** 0.5
        law = replace(integral_law(middle, delay_ticks=delay_ticks), max_feedback_v=1e200)
        error_um = np.abs(closed(law, 1.2, 400))
        early_um = error_um[150 * SAMPLES:250 * SAMPLES].max()
        stable = error_um[-50 * SAMPLES:].max() < max(early_um, 1e-9)
        low, high = (middle, high) if stable else (low, middle)
    return low


@pytest.mark.parametrize("delay_ticks", [0, 1, 3])
def test_law_is_refused_from_the_gain_on_at_which_the_loop_grows(delay_ticks):
    limit = critical_gain(delay_ticks)
    with pytest.raises(FeedbackLawError, match="not stable with the declared model at a hyst"):
        check_law(integral_law(1.02 * limit, delay_ticks=delay_ticks), SAMPLES)
    # Near the limit the loop is stable, but amplifies.
    with pytest.raises(FeedbackLawError, match="times as large"):
        check_law(integral_law(0.98 * limit, delay_ticks=delay_ticks), SAMPLES)
    check_law(integral_law(0.5 * limit, delay_ticks=delay_ticks), SAMPLES)


def test_ticks_that_are_written_ahead_count_as_delay():
    limit = critical_gain(2)
    check_law(integral_law(0.5 * limit), SAMPLES, lead_ticks=2)
    with pytest.raises(FeedbackLawError, match="not stable"):
        check_law(integral_law(1.02 * limit), SAMPLES, lead_ticks=2)


def test_integral_law_removes_a_constant_disturbance():
    displacement_um = closed(integral_law(0.1), 1.0, 100, disturbance_um=3.0)
    assert displacement_um[0] == 3.0
    assert np.abs(displacement_um[-SAMPLES:]).max() < 1e-3


def test_law_at_the_sample_rate_is_the_loop_of_python_control():
    """A disturbance behind one sample of delay: the sensitivity of python-control."""
    plant = second_order()
    filtered = control.ss([[0.9]], [[0.1]], [[0.3]], [[0.2]], CLOCK_S)
    law = FeedbackLaw(LinearBlock(), np.zeros(0), 1e6, np.zeros(1), np.zeros(0),
                      DeclaredPlant(block(plant), np.ones(1)), sample=block(filtered))
    check_law(law, SAMPLES)
    late = control.ss(control.tf([1.0], [1.0, 0.0], CLOCK_S))
    sensitivity = control.feedback(control.ss([], [], [], [[1.0]], CLOCK_S),
                                   plant * late * filtered)
    expected_um = control.step_response(sensitivity, CLOCK_S * np.arange(40 * SAMPLES)).outputs
    np.testing.assert_allclose(closed(law, 1.0, 40), expected_um, atol=1e-9)
    with pytest.raises(FeedbackLawError, match="not stable"):
        check_law(replace(law, sample=LinearBlock(d=8.0)), SAMPLES)
    with pytest.raises(FeedbackLawError, match="written ahead"):
        check_law(law, SAMPLES, lead_ticks=1)


@pytest.mark.parametrize("hold", [False, True])
def test_voltage_before_the_inverse_adds_the_wanted_output(hold):
    """The output of the hysteresis beside what is planned is the constant that is asked for."""
    density = np.tril(np.full((20, 20), 0.01))
    hysteresis = PreisachModel(0.0, 100.0, density, reversible_um_per_v=np.full(20, 0.1))
    constant = LinearBlock.of([1.0], [0.0], [1.0], [0.0])
    law = FeedbackLaw(constant, np.zeros(1), 50.0, np.full(1, 1.0), np.zeros(0),
                      DeclaredPlant(block(second_order()), np.ones(1)),
                      inverse=InverseHysteresis(hysteresis, 2.0, hold))
    running = RunningLaw(law, SAMPLES)
    running._state[:] = 1.5
    planned_v = (50 + 30 * np.sin(np.arange(40 * SAMPLES) / 30)).reshape(40, SAMPLES)
    plain, with_feedback = hysteresis.memory(), hysteresis.memory()
    for part_v in planned_v:
        feedback_v = running.begin(part_v).copy()
        difference_um = (hysteresis.simulate(part_v + feedback_v, with_feedback)
                         - hysteresis.simulate(part_v, plain))
        running.take(np.zeros(SAMPLES))
        if not running._acts:
            np.testing.assert_array_equal(feedback_v, 0.0)
        elif hold:
            assert np.ptp(feedback_v) == 0.0
            assert difference_um.mean() == pytest.approx(3.0, abs=0.2)
        else:
            np.testing.assert_allclose(difference_um, 3.0, atol=1e-9)


def test_law_that_takes_over_goes_on_without_a_bump():
    slow, fast = (integral_law(gain) for gain in (0.05, 0.2))
    running, plant = RunningLaw(slow, SAMPLES), second_order()
    state, given_v = np.zeros((2, 1)), []
    for tick in range(60):
        if tick == 12:
            other, running = running, RunningLaw(fast, SAMPLES)
            running.take_over(other)
        feedback_v = running.begin(np.zeros(SAMPLES))
        given_v.append(feedback_v[0])
        measured_um = []
        for value_v in feedback_v:
            measured_um.append((plant.C @ state).item() + 3.0)
            state = plant.A @ state + plant.B * value_v
        running.take(np.array(measured_um))
    steps_v = np.abs(np.diff(given_v))
    assert abs(given_v[11]) > 1.0
    # A law that began anew would go back to zero.
    assert steps_v[11] <= steps_v[10] and steps_v[12:].max() < 0.4
    assert given_v[-1] == pytest.approx(-3.0, abs=1e-2)


def test_law_before_another_hysteresis_takes_over_its_past():
    ones = np.tril(np.ones((10, 10)))
    laws = [integral_law(0.1, inverse=InverseHysteresis(
        PreisachModel(0.0, 100.0, factor * ones), 1.0)) for factor in (0.01, 0.02)]
    old, new = (RunningLaw(law, SAMPLES, 20.0) for law in laws)
    voltages_v = np.r_[60.0, 30.0, 50.0, np.full(7, 40.0)]
    old.begin(voltages_v)
    new.take_over(old)
    expected = laws[1].inverse.hysteresis.memory()
    laws[1].inverse.hysteresis.simulate(np.r_[20.0, voltages_v], expected)
    np.testing.assert_array_equal(
        new._inverse.past_v(PLAYED), expected.extremes_v[1:expected.top + 1])
    assert new._inverse._stacks[3, expected.top] == pytest.approx(expected.hysteresis_um)
    with pytest.raises(FeedbackLawError, match="between two runs"):
        new.take_over(RunningLaw(integral_law(0.1), SAMPLES))


def test_feedback_changes_by_no_more_than_the_largest_step():
    running = RunningLaw(integral_law(0.3), SAMPLES, largest_step_v=0.5)
    given_v = []
    for _ in range(10):
        given_v.append(running.begin(np.zeros(SAMPLES))[0])
        running.take(np.full(SAMPLES, -20.0))
        assert running.stepped
    np.testing.assert_allclose(np.diff(given_v), 0.5)


def test_error_is_that_of_the_reference_once_and_in_periods():
    law = replace(integral_law(1e-3), once_um=np.arange(15.0), period_um=np.array([1.0, 5.0]))
    running = RunningLaw(law, SAMPLES)
    errors_um = []
    for _ in range(3):
        running.begin(np.zeros(SAMPLES))
        running.take(np.full(SAMPLES, 2.0))
        errors_um.append(running.error_um)
    np.testing.assert_allclose(errors_um, [
        np.arange(10).mean() - 2.0, (np.arange(10, 15).sum() + 1 + 5 + 1 + 5 + 1) / 10 - 2.0, 1.0])


@pytest.mark.parametrize(("changes", "text"), [
    ({"tick": LinearBlock.of([np.nan], [1.0], [1.0], [0.0])}, "tick holds a value"),
    ({"observer": np.zeros(2)}, "observer has 2 elements for 1 states"),
    ({"tick": LinearBlock(), "observer": np.zeros(0)}, "neither tick nor sample"),
    ({"max_feedback_v": 0.0}, "max_feedback_v is 0"),
    ({"max_error_um": np.nan}, "max_error_um is nan"),
    ({"delay_ticks": 9}, "delay_ticks is 9"),
    ({"once_um": np.zeros(0)}, "no displacement is expected"),
    ({"period_um": np.array([np.inf])}, "period_expected_um holds a value"),
    ({"plant": DeclaredPlant(block(second_order()), np.array([-1.0]))}, "not positive"),
    ({"inverse": InverseHysteresis(PreisachModel(0.0, 1.0, -np.ones((1, 1))), 1.0)}, "negative"),
    ({"inverse": InverseHysteresis(PreisachModel(0.0, 1.0, np.ones((1, 1))), 0.0)}, "gain"),
])
def test_law_that_does_not_fit_is_refused(changes, text):
    with pytest.raises(FeedbackLawError, match=text):
        replace(integral_law(0.1), **changes)


def test_a_law_may_be_bounded_by_less_than_a_volt_and_a_micrometre():
    replace(integral_law(0.1), max_feedback_v=0.5, max_error_um=0.5)


@pytest.mark.parametrize("factor", [0.01, 0.1, 10.0])
def test_an_inverse_of_another_hysteresis_is_refused(factor):
    """Its voltages would be so many times too high or too low."""
    ones = np.tril(np.ones((10, 10)))
    law = integral_law(0.05, inverse=InverseHysteresis(
        PreisachModel(0.0, 100.0, 0.02 * ones), 1.0))
    check_law(law, SAMPLES)
    other = InverseHysteresis(PreisachModel(0.0, 100.0, 0.02 * factor * ones), 1.0)
    with pytest.raises(FeedbackLawError, match="take both from one model"):
        check_law(replace(law, inverse=other), SAMPLES)


def test_matrices_that_do_not_fit_are_refused():
    with pytest.raises(FeedbackLawError, match="3, 2, 2 and 1 elements"):
        LinearBlock.of([1, 2, 3], [1, 2], [1, 2], [0])


COMPILED = """
from piezo_models.feedback_law import law_kernels, running_law
running_law.compile_law()
kernels = [getattr(law_kernels, name) for name in ("take", "decide", "through_inverse")]
print([len(kernel.signatures) for kernel in kernels])
"""


def test_every_kernel_of_a_law_that_acts_is_compiled_before_a_run():
    ended = subprocess.run([sys.executable, "-c", COMPILED], capture_output=True, text=True,
                           timeout=300)
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout.strip() == "[1, 1, 1]"
