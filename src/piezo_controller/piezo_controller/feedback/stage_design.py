# SPDX-License-Identifier: BSD-3-Clause
"""A design from a model alone: the rules (5.9) to (5.11) choose the rate of the feedback."""

from dataclasses import dataclass
from pathlib import Path

from piezo_controller.feedback.computing_time import computing_time_s
from piezo_controller.feedback.feedback_design import FeedbackController, design_feedback
from piezo_controller.feedback.loop_rules import LoopRules, choose_rates
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

    Parameters
    ----------
    weights : str or Path
        "default", "thesis", or a file (YAML); used by `h_infinity` only.
    disturbance_hz : float
        Bandwidth of the disturbances (Hz).
    samples_per_tick : int, optional
        Feedback period in samples; chosen by the rules (5.10) by default.
    sample_rate_hz : float
        Rate of the stage's sample clock (Hz).

    Raises
    ------
    ValueError
        See `design_feedback`; also if the model has no dynamics, or the weights cannot be read.
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
