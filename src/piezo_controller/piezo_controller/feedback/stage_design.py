# SPDX-License-Identifier: BSD-3-Clause
"""A design from a model alone: the rules (5.9) to (5.11) choose the rate of the feedback."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import control
import numpy as np

from piezo_common.arrays import FloatArray
from piezo_controller.feedback.feedback_design import FeedbackController, design_feedback
from piezo_controller.feedback.multirate_feedback import MultirateFeedback
from piezo_controller.feedback.synthesis.design_choices import (
    DEFAULT_WEIGHTS,
    DISTURBANCE_HZ,
    METHODS,
    SAMPLE_RATE_HZ,
    SCALINGS,
    check_choices,
)
from piezo_controller.feedback.synthesis.weights import DesignWeights, load_weights
from piezo_controller.feedback.synthesis.ziegler_nichols import ultimate_point_by_relay
from piezo_models.cascade import StageModel

REPEATS = 2000
WARM_UP = 200
USUAL_ORDER = 15
SAMPLES_PER_TICK = 40
"""Timed and untimed answers, and the controller, by which the computing time is measured."""

# The thesis lies on the bound itself, and the ultimate frequency is no more accurate than this.
ON_THE_BOUND = 0.05

SUPPRESSION = 2.0
"""Least ratio of the feedback's bandwidth to that of the disturbances, ``gamma``."""


@dataclass(frozen=True)
class LoopRules:
    """Bounds within which the feedback is designed."""

    lowest_bandwidth_hz: float
    highest_bandwidth_hz: float
    """Bandwidth of the feedback, (5.9)."""
    lowest_rate_hz: float
    highest_rate_hz: float
    """Rate of the feedback, (5.10)."""
    samples_per_tick: int
    """Samples per tick at the chosen rate."""
    performance_hz: float
    robustness_hz: float
    """``omega_p`` and ``omega_s`` of (5.11) at that rate."""


def choose_rates(ultimate_hz: float, clock_hz: float, computing_s: float,
                 usual_samples_per_tick: int, disturbance_hz: float = 20.0) -> LoopRules:
    """Return the bounds of bandwidth and rate, and the rate to use; ValueError if there is none.

    The rate is the usual one if it is within its bounds; otherwise the slowest that is, since a
    high rate amplifies noise and costs computing time. A relay oscillates with the stage at the
    ultimate frequency, which is used for ``omega_r`` and ``omega_bc``. The rate of the sample clock
    is f_max, the computing time of one answer T_FB, the bandwidth of the disturbances ``omega_d``.
    """
    performance_hz = SUPPRESSION * disturbance_hz
    highest_bandwidth_hz = min(clock_hz / 2, 1 / computing_s, ultimate_hz)
    if performance_hz >= highest_bandwidth_hz:
        raise ValueError(f"disturbances up to {disturbance_hz:g} Hz need a bandwidth of "
                         f"{performance_hz:g} Hz, but {highest_bandwidth_hz:.4g} Hz is the most: "
                         "lower the bandwidth of the disturbances")
    lowest_rate_hz = 2 * max(performance_hz, ultimate_hz, disturbance_hz)
    highest_rate_hz = min(clock_hz, 1 / computing_s)
    if lowest_rate_hz > highest_rate_hz:
        raise ValueError(f"the feedback must answer {lowest_rate_hz:.4g} times a second, but can "
                         f"{highest_rate_hz:.4g} times: lower the controller's order")
    samples_per_tick = usual_samples_per_tick
    usual_hz = clock_hz / usual_samples_per_tick
    if not (1 - ON_THE_BOUND) * lowest_rate_hz <= usual_hz <= highest_rate_hz:
        samples_per_tick = math.floor(clock_hz / lowest_rate_hz)
    rate_hz = clock_hz / samples_per_tick
    return LoopRules(performance_hz, highest_bandwidth_hz, lowest_rate_hz, highest_rate_hz,
                     samples_per_tick, performance_hz,
                     min(rate_hz / 2, 1 / computing_s, ultimate_hz))


def answer_times_s(feedback: MultirateFeedback, samples_per_tick: int,
                   repeats: int = REPEATS,
                   clock_s: Callable[[], float] = time.perf_counter) -> FloatArray:
    """Time the answers to blocks of noise (s), shape (repeats,), without some to warm up.

    The feedback is reset afterwards.
    """
    expected_um = np.zeros(samples_per_tick)
    blocks_um = 1e-3 * np.random.default_rng(0).standard_normal((WARM_UP + repeats,
                                                                  samples_per_tick))
    taken_s = np.empty(len(blocks_um))
    for index, block_um in enumerate(blocks_um):
        begin_s = clock_s()
        feedback.step(expected_um, block_um)
        taken_s[index] = clock_s() - begin_s
    feedback.reset()
    return taken_s[WARM_UP:]


def computing_time_s() -> float:
    """Return the mean processor time of an answer of a controller of the usual order (s).

    Neither other programs nor a coarse clock of the processor time change what a design allows.
    """
    controller = control.ss(0.5 * np.eye(USUAL_ORDER), np.ones((USUAL_ORDER, 1)),
                            np.ones((1, USUAL_ORDER)), 0.0, True)
    times_s = answer_times_s(
        MultirateFeedback(controller), SAMPLES_PER_TICK, clock_s=time.thread_time)
    return float(np.mean(times_s))


@dataclass(frozen=True)
class StageDesign:
    """A controller, and the choices that led to it."""

    controller: FeedbackController

    weights: DesignWeights
    """Weights at the controller's tick, for the given bandwidth of the disturbances."""
    rules: LoopRules
    samples_per_tick: int

    clock_period_s: float
    """Period of the stage's sample clock (s)."""


def design_for_stage(
    model: StageModel, weights: str | Path = DEFAULT_WEIGHTS, method: str = METHODS[0],
    scaling: str = SCALINGS[0], disturbance_hz: float = DISTURBANCE_HZ,
    samples_per_tick: int | None = None, at_once: bool = False, reduce: bool = True,
    delay_ticks: int = 1, model_sha256: str = "", sample_rate_hz: float = SAMPLE_RATE_HZ,
) -> StageDesign:
    """Choose the rate of the feedback by the rules, then design it; see `design_feedback`.

    The weights, "default", "thesis", or a file (YAML), are those of `h_infinity`. The rules (5.10)
    choose the feedback period in samples, unless it is given. Raises ValueError as
    `design_feedback`, and if the model has no dynamics, or the weights cannot be read.
    """
    check_choices(method, scaling)
    if model.linear().nstates <= len(model.creep.poles_rad_per_s):
        raise ValueError("the model has no dynamics, by which a feedback is designed: identify it "
                         "with a recording of the dynamics as well")
    clock_s = 1.0 / sample_rate_hz
    chosen = load_weights(weights)
    rules = choose_rates(
        1 / ultimate_point_by_relay(model, 1, clock_s).period_s, sample_rate_hz,
        computing_time_s(),
        samples_per_tick or max(1, round(chosen.sample_period_s / clock_s)), disturbance_hz)
    samples = samples_per_tick or rules.samples_per_tick
    chosen = chosen.for_disturbances(disturbance_hz).at_tick(samples * clock_s)
    controller = design_feedback(model, chosen, clock_s, model_sha256, method, scaling,
                                 at_once, reduce, delay_ticks)
    return StageDesign(controller, chosen, rules, samples, clock_s)
