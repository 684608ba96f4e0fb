# SPDX-License-Identifier: BSD-3-Clause
"""A stage of two axes that evaluates one law for both: it acts, and a fault of one stops both."""

from dataclasses import replace

import numpy as np
import pytest

from piezo_models.feedback_law.feedback_law import (
    DeclaredPlant,
    FeedbackLaw,
    FeedbackLawError,
    LinearBlock,
)
from piezo_stage_driver.engine.program import StageRefusal
from piezo_stage_driver.engine.stage_engine import StageEngine
from piezo_stage_driver.safety.guards import FeedbackOscillation, SensorRange
from piezo_stage_driver.safety.limits import (
    AxesLimits,
    FeedbackLimits,
    LimitError,
    VoltageLimits,
)

AXES, TICK = ("x", "y"), 40
MOVES_UM_PER_V = np.array([[0.5, 0.05], [-0.02, 0.25]])
REST_V = np.array([0.0, 10.0])
ONCE, PERIOD, PERIODS = 2000, 400, 12


class Backend:
    """Moves both axes with each voltage, from sample to sample, by an amount that is off."""

    sample_rate_hz = 40_000.0
    axes = AXES

    def __init__(self, offset_um=(0.0, 0.0)):
        self.offset_um, self.played_v = np.array(offset_um), []
        self.spoil = lambda displacement_um: None

    def exchange(self, voltage_v):
        self.played_v.append(voltage_v)
        displacement_um = voltage_v @ MOVES_UM_PER_V.T + self.offset_um
        self.spoil(displacement_um)
        return displacement_um


def engine_of(backend, **options):
    limits = {"x": VoltageLimits(-20.0, 120.0, 2e6), "y": VoltageLimits(-20.0, 60.0, 2e6)}
    return StageEngine(
        backend, AxesLimits(limits), REST_V, np.array([2000.0, 1000.0]),
        sensor_guards={axis: (SensorRange(-30.0, 90.0),) for axis in AXES},
        feedback_guard={axis: FeedbackOscillation(4.0) for axis in AXES},
        feedback_limits=FeedbackLimits(20.0, 15.0, 3), **options)


def planned_v():
    """Return the way from rest and a period, which moves x by 40 V and y by 20 V."""
    turn = 2.0 * np.pi * np.arange(PERIOD) / PERIOD
    period_v = np.column_stack([40.0 + 20.0 * np.cos(turn), 30.0 + 10.0 * np.sin(turn)])
    rise = np.linspace(0.0, 1.0, ONCE)[:, None]
    return REST_V + rise * (period_v[0] - REST_V), period_v


def law_of(**changes):
    """Return an integration of the error of each axis, through the inverse of the stage."""
    once_v, period_v = planned_v()
    gains = MOVES_UM_PER_V.diagonal()
    late = LinearBlock.of(np.zeros((2, 2)), np.eye(2), MOVES_UM_PER_V / gains, np.zeros((2, 2)), 2)
    tick = LinearBlock.of(np.eye(2), 0.4 * np.linalg.inv(MOVES_UM_PER_V), np.eye(2),
                          0.4 * np.linalg.inv(MOVES_UM_PER_V), 2)
    return replace(FeedbackLaw(
        tick, 0.5 * np.eye(2), 10.0, once_v @ MOVES_UM_PER_V.T, period_v @ MOVES_UM_PER_V.T,
        DeclaredPlant(late, gains[None, :]), ONCE, max_error_um=2.0, fade_samples=400, axes=AXES),
        **changes)


def track(engine, law, ticks=(ONCE + PERIODS * PERIOD) // TICK):
    """Track with a law; return voltages, displacements and feedback voltages of the run."""
    once_v, period_v = planned_v()
    engine.commands.load_feedforward(once_v.ravel(), period_v.ravel(), axes=AXES)
    engine.commands.load_feedback(engine.commands.checked(law))
    engine.commands.start_tracking(False, ticks, onboard=True)
    blocks = []
    while engine.phase_name == "track":
        blocks.append(engine.advance())
    blocks = [block for block in blocks if block is not None and block.feedback_v is not None]
    return tuple(np.concatenate(parts) for parts in zip(*(
        (block.voltage_v, block.displacement_um, block.feedback_v) for block in blocks),
        strict=True))


def rest(engine):
    while not engine.at_rest:
        engine.advance()


def test_law_of_both_axes_removes_the_errors_of_each():
    engine = engine_of(Backend((1.0, -0.5)))
    voltage_v, displacement_um, feedback_v = track(engine, law_of())
    once_v, period_v = planned_v()
    expected_um = np.tile(period_v @ MOVES_UM_PER_V.T, (PERIODS, 1))
    error_um = displacement_um[ONCE:] - expected_um
    assert np.allclose(error_um[:TICK], [1.0, -0.5])
    assert np.abs(error_um[-PERIOD:]).max() < 1e-6
    assert feedback_v.shape == (len(voltage_v) // TICK, 2) and not feedback_v[:ONCE // TICK].any()
    assert np.allclose(MOVES_UM_PER_V @ feedback_v[-1], [-1.0, 0.5], atol=1e-6)
    assert np.array_equal(voltage_v[:ONCE], once_v)
    rest(engine)
    assert not engine.stop_cause and np.array_equal(engine.voltage_v, REST_V)


def test_voltage_that_the_range_of_one_axis_cuts_does_not_wind_up():
    backend = Backend()
    engine, disturbed = engine_of(backend), range(ONCE + 10 * TICK, ONCE + 70 * TICK)

    def spoil(displacement_um):  # takes 36 V of y; its range leaves 20 V, and 40 V at times
        displacement_um[:, 1] -= 9.0 * (engine.next_sample in disturbed)

    backend.spoil = spoil
    _, _, feedback_v = track(engine, law_of(max_feedback_v=20.0, max_error_um=20.0))
    assert np.concatenate(backend.played_v)[:, 1].max() == 60.0
    assert feedback_v[:, 1].max() > 19.0
    assert np.abs(feedback_v[(ONCE // TICK) + 85:]).max() < 0.1


@pytest.mark.parametrize(("column", "axis"), [(0, "x"), (1, "y")])
def test_error_that_grows_on_one_axis_stops_both(column, axis):
    backend = Backend()
    engine, begins = engine_of(backend), ONCE + 3 * PERIOD

    def spoil(displacement_um):
        if engine.next_sample > begins:
            displacement_um[:, column] += 0.02 * (engine.next_sample - begins)

    backend.spoil = spoil
    track(engine, law_of())
    assert engine.stop_cause.startswith(f"{axis}: the feedback law has an error of")
    rest(engine)
    assert np.array_equal(engine.voltage_v, REST_V)


@pytest.mark.parametrize("factor", [0.2, 5.0])
def test_law_for_another_gain_of_one_axis_is_stopped_before_it_acts(factor):
    moves = MOVES_UM_PER_V * [[1.0], [factor]]
    gains, law = moves.diagonal(), law_of()
    other = DeclaredPlant(replace(law.plant.linear, c=moves / gains), gains[None, :])
    engine = engine_of(Backend())
    tick = replace(law.tick, b=0.1 * law.tick.b, d=0.1 * law.tick.d)
    _, _, feedback_v = track(engine, replace(law, plant=other, tick=tick, max_error_um=50.0))
    assert engine.stop_cause.startswith("y: the stage moved by 0.2")
    assert not feedback_v.any()


def test_axis_that_compensates_the_coupling_at_rest_is_not_taken_for_another_gain():
    once_v, period_v = planned_v()
    moved_um = period_v @ MOVES_UM_PER_V.T
    moved_um[:, 1] = moved_um[:, 1].mean()
    still_v = np.linalg.solve(MOVES_UM_PER_V, moved_um.T).T
    law, engine = law_of(period_um=moved_um), engine_of(Backend())
    way_v = np.linspace(REST_V, still_v[0], ONCE)
    engine.commands.load_feedforward(way_v.ravel(), still_v.ravel(), axes=AXES)
    engine.commands.load_feedback(engine.commands.checked(replace(
        law, once_um=np.concatenate([way_v, still_v]) @ MOVES_UM_PER_V.T,
        start_sample=ONCE + PERIOD)))
    engine.commands.start_tracking(False, 100, onboard=True)
    while engine.phase_name == "track":
        engine.advance()
    assert not engine.stop_cause


def test_feedback_that_oscillates_on_one_axis_stops_both():
    law, more = law_of(max_error_um=np.inf), [1.0, 2.9]  # times as far as the law declares
    backend = Backend((0.0, 0.1))
    backend.spoil = lambda displacement_um: displacement_um.__imul__(more)
    engine = engine_of(backend)
    track(engine, replace(
        law, tick=replace(law.tick, b=2.0 * law.tick.b, d=2.0 * law.tick.d),
        period_um=law.period_um * more, once_um=law.once_um * more))
    assert engine.stop_cause.startswith("y: the feedback oscillates with growing amplitude")
    rest(engine)


@pytest.mark.parametrize("axes", [(), ("y", "x")])
def test_law_and_feedforward_of_other_axes_are_refused(axes):
    engine, law = engine_of(Backend()), law_of()
    with pytest.raises(StageRefusal, match="the stage has the axes x, y: give a voltage of each"):
        engine.commands.load_feedforward(np.zeros(80), (), axes=axes)
    if axes:
        with pytest.raises(StageRefusal, match="the feedback law is of the axes y, x, the stage"):
            engine.commands.checked(replace(law, axes=axes))


def test_answers_and_a_replacement_within_the_run_are_refused():
    engine, law = engine_of(Backend()), law_of()
    once_v, period_v = planned_v()
    engine.commands.load_feedforward(once_v.ravel(), period_v.ravel(), axes=AXES)
    with pytest.raises(StageRefusal, match="nobody answers the blocks of several axes"):
        engine.commands.start_tracking(True)
    checked = engine.commands.checked(law)
    engine.commands.load_feedback(checked)
    engine.commands.start_tracking(False, onboard=True)
    engine.advance()
    with pytest.raises(FeedbackLawError, match="load it between two runs"):
        engine.commands.load_feedback(checked)


def test_first_voltage_of_each_axis_must_be_near():
    engine = engine_of(Backend())
    engine.commands.load_feedforward(np.tile([0.0, 14.0], 40), (), axes=AXES)
    with pytest.raises(LimitError, match="y: the voltage jumps by 4 V to sample 0"):
        engine.commands.start_tracking(False)


def test_feedforward_without_a_period_holds_the_last_voltage_of_each_axis():
    backend = Backend()
    engine = engine_of(backend)
    engine.commands.load_feedforward(np.tile([1.0, 10.5], 50), (), axes=AXES)
    engine.commands.start_tracking(False, 3)
    while engine.phase_name == "track":
        engine.advance()
    assert np.array_equal(np.concatenate(backend.played_v)[:120], np.tile([1.0, 10.5], (120, 1)))
