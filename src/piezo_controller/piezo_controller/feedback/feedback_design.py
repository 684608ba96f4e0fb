# SPDX-License-Identifier: BSD-3-Clause
"""Design of the feedback at the tick's rate: H-infinity (thesis 5.2.4), PID and PI."""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import control
import numpy as np

from piezo_common.arrays import FloatArray
from piezo_common.summary_table import SummaryTable
from piezo_controller.feedback.controller_view import (
    draw_controller,
    summary_of_controller,
    text_of_controller,
)
from piezo_controller.feedback.loop_measures import measure_loop
from piezo_controller.feedback.synthesis.design_choices import check_choices
from piezo_controller.feedback.synthesis.dk_iteration import iterate, scale, tick_frequencies
from piezo_controller.feedback.synthesis.generalised_plant import (
    UNCERTAINTIES,
    design_plant,
    generalised_plant,
    hysteresis_gain_range,
)
from piezo_controller.feedback.synthesis.h_infinity import close, is_stable, reduce_order
from piezo_controller.feedback.synthesis.structured_singular_value import (
    sampled_response,
    structured_singular_values,
)
from piezo_controller.feedback.synthesis.weights import DesignWeights
from piezo_controller.feedback.synthesis.ziegler_nichols import (
    pid,
    proportional_integral,
    ultimate_point_by_relay,
    ultimate_point_by_response,
)
from piezo_models.cascade import StageModel

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Damps the controller's resonance at 270 Hz, and lowers the peak of the sensitivity.
SLACK = 0.1
# Largest increase of the scaled norm by a reduction of the order, as a part of it.
REDUCTION_COST = 0.01
FREQUENCIES = 200


class UnstableLoop(ValueError):
    """A feedback that does not stabilise the model it is to be used with."""


@dataclass(frozen=True)
class FeedbackController:
    """State space of the feedback, and the properties of the loop it closes."""

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    """From the mean tracking error of the last tick (um) to the voltage of the next (V)."""
    sample_period_s: float
    """Period of the tick (s)."""
    report: dict
    """Numbers and texts that describe the loop, see `design_feedback`."""
    weights: dict
    """Weights that it was designed with, in the layout of the weights file; empty for PID."""
    model_sha256: str = ""
    """Hash of the model file that it was designed for; empty if the model came from no file."""

    def __repr__(self) -> str:
        return text_of_controller(self)

    def _repr_html_(self) -> str:
        return self.summary()._repr_html_()

    def summary(self) -> SummaryTable:
        """Return the properties of the loop as a table."""
        return summary_of_controller(self)

    def plot(self, model: StageModel | None = None) -> "Figure":
        """Draw the controller, or its loop with a model; see `controller_view.draw_controller`."""
        return draw_controller(self, model)

    def state_space(self) -> control.StateSpace:
        """Return the controller as a ``control.StateSpace``."""
        return control.ss(self.A, self.B, self.C, self.D, self.sample_period_s)

    @property
    def delay_ticks(self) -> int:
        """Return the ticks of computing time that it was designed for: 1 unless reported."""
        return int(self.report.get("delay_ticks", 1))

    @property
    def hysteresis_gain_um_per_v(self) -> float:
        """Return the gain of the hysteresis that it was designed for; ValueError without one."""
        if "hysteresis_gain_um_per_v" not in self.report:
            raise ValueError("the controller's report has no hysteresis_gain_um_per_v: make it by "
                             "feedback_from_control, or set feedback_place to behind_inverse")
        return float(self.report["hysteresis_gain_um_per_v"])


def design_feedback(model: StageModel, weights: DesignWeights, clock_period_s: float = 25e-6,
                    model_sha256: str = "", method: str = "h_infinity", scaling: str = "constant",
                    at_once: bool = False, reduce: bool = True,
                    delay_ticks: int = 1) -> FeedbackController:
    """Design the feedback for a model of the stage.

    Parameters
    ----------
    weights : DesignWeights
        Weights of the design; PID and PI take only the tick from it.
    clock_period_s : float
        Period of the sample clock (s).
    model_sha256 : str
        Hash of the model's file, kept with the controller.
    method : str
        ``h_infinity``; ``pid``, by a relay that oscillates with the model; ``pi``, by the
        ultimate gain of the linear dynamics, corrected for the hysteresis.
    scaling : str
        ``constant`` or ``dynamic``: D of the D-K iteration.
    at_once, delay_ticks
        Loop without averaging and computing time; ticks of computing time, 1 for PID. See
        `design_plant`.
    reduce : bool
        Whether to lower the order if that costs next to nothing.

    Returns
    -------
    FeedbackController
        Its report holds ``method``, ``at_once``, ``delay_ticks``, ``order``,
        ``hysteresis_gain_um_per_v``, ``hysteresis_gain_spread`` and the measures of
        `measure_loop` at that spread; for ``h_infinity`` ``scaling``, ``gamma``, ``mu``,
        ``mu_history`` (of the iteration) and ``order_before_reduction``; else
        ``ultimate_gain_v_per_um`` and ``ultimate_period_s``.

    Raises
    ------
    NoController, NoOscillation
        If the weights cannot be satisfied; if the model has no ultimate gain.
    UnstableLoop
        If the loop is unstable at a gain of the hysteresis.
    ValueError
        If `method` or `scaling` is unknown.
    """
    check_choices(method, scaling)
    tick_s = weights.sample_period_s
    if method == "pid" and delay_ticks != 1:
        raise ValueError("PID is found by a relay that answers by messages: give delay_ticks 1")
    plant, gain_um_per_v = design_plant(model, tick_s, clock_period_s, at_once, delay_ticks)
    if method == "h_infinity":
        controller, found = h_infinity_feedback(plant, gain_um_per_v, weights, scaling, reduce)
    else:
        controller, found = _ziegler_nichols(method, model, plant, tick_s, clock_period_s)
    report = {"method": method, "at_once": at_once, "delay_ticks": delay_ticks, **found,
              **_measures(controller, model, plant, gain_um_per_v)}
    if not report["stable_within_gain_spread"]:
        raise UnstableLoop(f"{method} gives a loop that is not stable for every gain of the "
                           "hysteresis: use h_infinity, or another tick")
    return FeedbackController(controller.A, controller.B, controller.C, controller.D, tick_s,
                              report, weights.model_dump() if method == "h_infinity" else {},
                              model_sha256)


def feedback_from_control(system: control.StateSpace | control.TransferFunction, model: StageModel,
                          clock_period_s: float = 25e-6, model_sha256: str = "",
                          method: str = "own", delay_ticks: int = 1) -> FeedbackController:
    """Convert a feedback of any origin, and measure the loop that it closes.

    Parameters
    ----------
    system : control.StateSpace or control.TransferFunction
        Discrete, with the period of the tick: from the mean tracking error of the last tick (um)
        to the voltage of the next (V).
    clock_period_s : float
        Period of the sample clock (s).
    model_sha256 : str
        Hash of the model's file, kept with the controller.
    method : str
        Name of the method in the report.
    delay_ticks : int
        Ticks of computing time, see `design_plant`.

    Returns
    -------
    FeedbackController
        Its report holds ``method``, ``delay_ticks``, ``order``, ``hysteresis_gain_um_per_v``,
        ``hysteresis_gain_spread`` and the measures of `measure_loop` at that spread.

    Raises
    ------
    UnstableLoop
        If the loop is unstable, see `check_stabilises`.
    ValueError
        If the system has no period, a period that is no multiple of the sample clock's, no state,
        or more than one input or output.
    """
    system = control.ss(system)
    if (system.ninputs, system.noutputs) != (1, 1):
        raise ValueError(f"the feedback has {system.ninputs} inputs and {system.noutputs} outputs: "
                         "give one from an error to a voltage")
    if not system.isdtime(strict=True) or system.dt is True:
        raise ValueError("the feedback has no sample period: give a discrete system with that of "
                         "the tick, as by control.sample_system(system, 1e-3)")
    if not system.nstates:
        raise ValueError("the feedback has no state, so an error stays: add an integration")
    controller = FeedbackController(
        system.A, system.B, system.C, system.D, float(system.dt), {"delay_ticks": delay_ticks}, {},
        model_sha256)
    check_stabilises(controller, model, clock_period_s)
    measures = _measures(system, model, *design_plant(
        model, system.dt, clock_period_s, delay_ticks=delay_ticks))
    return replace(controller, report={"method": method, **controller.report, **measures})


def check_stabilises(controller: FeedbackController, model: StageModel,
                     clock_period_s: float = 25e-6) -> None:
    """Raise `UnstableLoop` if a controller does not stabilise a model in the loop of the stage.

    The loop must be stable at the lowest, the nominal and the highest gain of the hysteresis at
    mid-travel.
    """
    plant, nominal = design_plant(model, controller.sample_period_s, clock_period_s,
                                  delay_ticks=controller.delay_ticks)
    for gain_um_per_v in (nominal, *hysteresis_gain_range(model)):
        loop = gain_um_per_v * plant * controller.state_space()
        if not is_stable(control.feedback(loop, 1)):
            raise UnstableLoop(
                "the controller does not stabilise the model at a hysteresis gain of "
                f"{gain_um_per_v:.3g} um/V: design one for this model")


def structured_singular_value(problem: control.StateSpace,
                              controller: control.StateSpace) -> tuple[FloatArray, FloatArray]:
    """Return frequencies (Hz) and the structured singular value of a closed loop there, (F,).

    The problem is a `generalised_plant`.
    """
    frequency_hz = tick_frequencies(problem.dt, FREQUENCIES)
    responses = sampled_response(close(problem, controller),
                                 np.exp(2j * np.pi * frequency_hz * problem.dt))
    return frequency_hz, structured_singular_values(
        responses, UNCERTAINTIES * controller.ninputs)[0]


def _measures(controller: control.StateSpace, model: StageModel, plant: control.StateSpace,
              gain_um_per_v: float) -> dict[str, Any]:
    """Return the part of the report that all controllers have."""
    spread = hysteresis_gain_range(model)[1] / gain_um_per_v - 1
    return {"order": controller.nstates, "hysteresis_gain_um_per_v": gain_um_per_v,
            "hysteresis_gain_spread": spread,
            **measure_loop(gain_um_per_v * plant, controller, spread)}


def h_infinity_feedback(
    plant: control.StateSpace, gain_um_per_v: float, weights: DesignWeights, scaling: str,
    reduce: bool,
) -> tuple[control.StateSpace, dict[str, Any]]:
    """Return the H-infinity feedback of a plant of one axis or several, and its part of the report.

    For plant and gain see `generalised_plant`, for the others `design_feedback`; the scaling is
    constant if there are several axes. Raises `NoController` if the weights cannot be satisfied.
    """
    problem, axes = generalised_plant(plant, gain_um_per_v, weights), plant.ninputs
    synthesis = iterate(problem, UNCERTAINTIES, scaling == "dynamic", SLACK, axes)
    controller = synthesis.controller
    if reduce:
        scaled = scale(problem, synthesis.scalings, axes)
        limit = (1 + REDUCTION_COST) * control.linfnorm(close(scaled, controller))[0]
        controller = reduce_order(controller, lambda candidate: (
            is_stable(close(scaled, candidate))
            and control.linfnorm(close(scaled, candidate))[0] <= limit))
    return controller, {
        "scaling": scaling, "gamma": float(synthesis.gamma),
        "mu": float(structured_singular_value(problem, controller)[1].max()),
        "mu_history": synthesis.history,
        "order_before_reduction": synthesis.controller.nstates,
    }


def _ziegler_nichols(method: str, model: StageModel, plant: control.StateSpace, tick_s: float,
                     clock_period_s: float) -> tuple[control.StateSpace, dict[str, Any]]:
    if method == "pid":
        ultimate = ultimate_point_by_relay(model, round(tick_s / clock_period_s), clock_period_s)
        controller = pid(ultimate, tick_s)
    else:
        ultimate = ultimate_point_by_response(plant, hysteresis_gain_range(model)[1])
        controller = proportional_integral(ultimate, tick_s)
    return controller, {"ultimate_gain_v_per_um": ultimate.gain,
                        "ultimate_period_s": ultimate.period_s}
