# SPDX-License-Identifier: BSD-3-Clause
"""Track on the simulated stage with the identified model, with offset, drift, noise and delay."""

from dataclasses import dataclass
from functools import cache

import numpy as np

from piezo_controller.feedback.feedback_before_inverse import FeedbackBeforeInverse
from piezo_controller.feedback.feedback_design import FeedbackController, design_feedback
from piezo_controller.feedback.multirate_feedback import MultirateFeedback
from piezo_controller.feedback.onboard_law import onboard_law
from piezo_controller.feedback.synthesis.weights import load_weights
from piezo_controller.feedback.synthesis.ziegler_nichols import UltimatePoint, pid
from piezo_controller.references.reference import Reference
from piezo_controller.tracking.tracking_modes import (
    FEEDBACK_METHODS,
    StageClock,
    feedback_room_v,
    plan_mode,
)
from piezo_controller.tracking.tracking_run import TrackingRun
from piezo_models.feedback_law.running_law import RunningLaw
from piezo_models.measures import e_rms_percent
from piezo_sim.simulated_stage import SimulatedStage
from piezo_studies.thesis.identified_stage import identified_stage
from piezo_studies.thesis.offline_loop import PlayedRun, play_law, play_run

CENTRE_UM = 52.0
OFFSET_UM = 2.1
"""Offset of the displacement, as in Fig. 2.9 (a)."""

DRIFT_UM_PER_S = 0.05
DURATION_S = 0.3
SETTLING_S = 0.1
"""Time excluded at the start, so that errors are those of the steady state, as in the thesis."""

PRINTED_PI, PRINTED_PID = "printed_pi", "printed_pid"
"""Names of the controllers (3.23) and (2.31) with the printed coefficients."""

FAST = 1
"""Samples in a tick for feedback at the sample rate, as in chapter 3."""


@dataclass(frozen=True)
class Tracked:
    """The errors of one tracking run."""

    mode: str

    e_rms_percent: float
    true_e_rms_percent: float
    centred_e_rms_percent: float
    """Errors (2.32) in the steady state: by the sensor, of the true position, and by the sensor
    with the offset removed."""
    error_um: np.ndarray
    reference_um: np.ndarray
    """Error by the sensor, and reference, in the steady state, (N,)."""
    played: PlayedRun

    @property
    def remark(self):
        """Remark for a table: a feedforward cannot correct the offset; else the true error."""
        if self.mode == "feedforward":
            return f"{self.centred_e_rms_percent:.2g} % without the offset, which it cannot predict"
        return f"true position: {self.true_e_rms_percent:.2g} %"


@cache
def controller(method="h_infinity", samples_per_tick=40, delay_ticks=1):
    """Return the feedback designed for the identified model, a tick and a computing delay."""
    clock = StageClock(samples_per_tick=samples_per_tick)
    if method == PRINTED_PI:
        one = np.ones((1, 1))
        return FeedbackController(one, one, (1.01 - 0.976) * one, 1.01 * one, clock.tick_s, {}, {})
    if method == PRINTED_PID:
        found = pid(UltimatePoint(2.62, 0.002), clock.tick_s)
        return FeedbackController(found.A, found.B, found.C, found.D, clock.tick_s, {}, {})
    return design_feedback(identified_stage(), load_weights().at_tick(clock.tick_s),
                           clock.sample_period_s, method=method, delay_ticks=delay_ticks)


@cache
def track(mode, frequency_hz, amplitude_um, samples_per_tick=40, duration_s=DURATION_S,
          method=None, jump_s=None, before_inverse=False, onboard=False):
    """Track a sine of a peak-to-peak amplitude with the identified model on the simulated stage.

    The steady state lasts for `duration_s`. The offset appears at `jump_s` of it; by default, it is
    always present. The method of the feedback is that of the mode by default. The feedback may act
    before the inverse hysteresis, or be evaluated by the stage, and is then designed without delay.
    """
    clock = StageClock(samples_per_tick=samples_per_tick)
    reference = Reference("harmonic", (frequency_hz,), (amplitude_um,), (), CENTRE_UM)
    played_s = SETTLING_S + duration_s
    plan = plan_mode(mode, reference, identified_stage(), clock, played_s)
    feedback = law = None
    if mode in FEEDBACK_METHODS:
        tuned = controller(method or FEEDBACK_METHODS[mode], samples_per_tick, 1 - onboard)
        room_v = feedback_room_v(plan, clock.voltage_range_v)
        if onboard:
            law = RunningLaw(onboard_law(tuned, identified_stage(), plan, clock.sample_period_s,
                                         room_v, before_inverse), samples_per_tick)
        else:
            feedback = FeedbackBeforeInverse(
                tuned, identified_stage(), plan, samples_per_tick, room_v,
            ) if before_inverse else MultirateFeedback(tuned, room_v)
    samples = round(played_s * clock.sample_rate_hz)
    first = plan.once_voltage_v.size + round(SETTLING_S * clock.sample_rate_hz)
    total = plan.once_voltage_v.size + samples
    disturbance_um = DRIFT_UM_PER_S * np.arange(total) * clock.sample_period_s
    jump = 0 if jump_s is None else first + round(jump_s * clock.sample_rate_hz)
    disturbance_um[jump:] += OFFSET_UM

    stage = SimulatedStage(seed=7)
    stage.open()
    true_um: list[np.ndarray] = []

    def exchange(voltage_v):
        begin = len(true_um) * samples_per_tick
        disturbed_um = disturbance_um[begin:begin + voltage_v.size]
        measured_um = stage.exchange(voltage_v) + disturbed_um
        true_um.append(stage.true_displacement_um + disturbed_um)
        return measured_um

    run = TrackingRun(plan, samples, feedback, clock.tick_s)
    played = (play_law(run, law, plan, exchange) if law
              else play_run(run, plan, exchange, samples_per_tick))
    reference_um = plan.expected_um(first, total - first)
    measured_um = played.displacement_um[first:]
    return Tracked(
        mode, e_rms_percent(reference_um, measured_um),
        e_rms_percent(reference_um, np.concatenate(true_um)[first:]),
        e_rms_percent(reference_um, measured_um, remove_offset=True),
        reference_um - measured_um, reference_um, played)
