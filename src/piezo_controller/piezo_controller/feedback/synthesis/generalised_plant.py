# SPDX-License-Identifier: BSD-3-Clause
"""The design problem of the H-infinity feedback: plant, uncertainties, weights (thesis 5.2.4)."""

import control
import numpy as np

from piezo_controller.feedback.synthesis.weights import DesignWeights
from piezo_models.cascade import StageModel
from piezo_models.effects.bouc_wen_hysteresis import BoucWenHysteresis
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import zoh
from piezo_models.linear.lifted import lift as lift_matrices

UNCERTAINTIES = 2
"""Scalar uncertainties of `generalised_plant` for each axis, which are its first inputs and
outputs."""


def design_plant(model: StageModel, tick_s: float, clock_period_s: float,
                 at_once: bool = False, delay_ticks: int = 1) -> tuple[control.StateSpace, float]:
    """Return the linear plant that the feedback is designed for, and the nominal gain k_h (um/V).

    The plant leads from the hysteresis' output decided in a tick to the displacement known in it
    (um per um), including the hold and the delay of the sensor.

    Parameters
    ----------
    tick_s, clock_period_s : float
        Periods of the feedback and of the sample clock (s); the former is a multiple of the latter.
    at_once : bool
        Whether to sample at the beginning of the tick and answer at once, as in the thesis,
        instead of the averaging and the tick of computing time of the stage.
    delay_ticks : int
        Ticks of computing time: 1 if a node answers the stage, 0 if the stage evaluates the
        feedback by itself.
    """
    samples_per_tick = round(tick_s / clock_period_s)
    if samples_per_tick < 1 or abs(samples_per_tick * clock_period_s / tick_s - 1) > 1e-9:
        raise ValueError(f"the tick of {tick_s:g} s is no multiple of the sample clock's period "
                         f"of {clock_period_s:g} s")
    plant = clock_plant(model, tick_s) if at_once else lift(
        clock_plant(model, clock_period_s), samples_per_tick, delay_ticks)
    return plant, nominal_hysteresis_gain(model)


def clock_plant(model: StageModel, period_s: float) -> control.StateSpace:
    """Return the sampled linear part of the stage, with the sensor's delay (um per um)."""
    linear = model.linear()
    for effect in (*model.effects_at("displacement"), *model.effects_at("sensor")):
        linear = (effect.lag() or 1.0) * linear
    return zoh(linear, period_s)


def hysteresis_gain_range(model: StageModel) -> tuple[float, float]:
    """Return the lowest and highest secant gain (3.16) of the hysteresis at mid-travel (um/V).

    In front of it, a Bouc-Wen hysteresis has the slopes of its loops.
    """
    lowest, highest = secant_gain_range(model.hysteresis)
    for effect in model.effects_at("voltage"):
        if isinstance(effect, BoucWenHysteresis):
            least, most = effect.gain_range
            lowest, highest = lowest * least, highest * most
    return lowest, highest


def secant_gain_range(hysteresis: PreisachModel) -> tuple[float, float]:
    """Return the lowest and highest secant gain (3.16) of a hysteresis at mid-travel (um/V)."""
    middle_v = (hysteresis.voltage_min_v + hysteresis.voltage_max_v) / 2
    return hysteresis.gain_um_per_v([middle_v])


def nominal_hysteresis_gain(model: StageModel) -> float:
    """Return the gain k_h that feedbacks are designed on, the middle of their range (um/V)."""
    return float(np.mean(hysteresis_gain_range(model)))


def generalised_plant(plant: control.StateSpace, hysteresis_gain_um_per_v: float,
                      weights: DesignWeights) -> control.StateSpace:
    """Return the generalised plant of thesis figs. 5.2 and 5.5, for each axis of a plant.

    There are two complex uncertainties of at most 1 for each axis: the hysteresis' gain differs
    from its nominal value by ``w_u`` times the first, and the feedforward has an error of
    ``w_delta`` times the second, relative to the reference (5.12). The performance is one more
    block. Plant and gain are the results of `design_plant`; the plant has as many inputs as
    outputs.

    The inputs are the outputs of the uncertainties, reference, disturbance, noise and control, the
    outputs the inputs of the uncertainties, weighted error, weighted control and measured error.
    Each has an element for each axis.
    """
    dt, axes = plant.dt, plant.ninputs

    def each(signal: str) -> list[str]:
        return [f"{signal}[{axis}]" for axis in range(axes)]

    def named(system: control.StateSpace, name: str, source: str, sink: str) -> control.StateSpace:
        return control.ss(system.A, system.B, system.C, system.D, dt, name=name,
                          inputs=each(source), outputs=each(sink))

    def gain(value: float, name: str, source: str, sink: str) -> control.StateSpace:
        return named(control.ss([], [], [], value * np.eye(axes), dt), name, source, sink)

    def weight(name: str, source: str, sink: str) -> control.StateSpace:
        own = getattr(weights, name).state_space(dt)
        return named(control.append(*[own] * axes), name, source, sink)

    def total(sources: list[str], sink: str, name: str) -> control.StateSpace:
        return control.summing_junction(sources, sink, axes, name=name, dt=dt)

    return control.interconnect(
        [
            gain(weights.hysteresis_uncertainty, "uncertain_gain", "u", "gain_in"),
            total(["u", "gain_out"], "u_total", "input"),
            named(hysteresis_gain_um_per_v * plant, "plant", "u_total", "y"),
            weight("reference", "r", "feedforward_in"),
            gain(weights.feedforward_error, "uncertain_feedforward", "feedforward_out",
                 "feedforward_error"),
            weight("disturbance", "d", "offset"),
            total(["-feedforward_error", "-offset", "-y"], "e", "error"),
            weight("performance", "e", "weighted_error"),
            weight("control", "u", "weighted_control"),
            weight("noise", "n", "sensor_noise"),
            total(["e", "-sensor_noise"], "m", "measurement"),
        ],
        inputs=sum(map(each, ("gain_out", "feedforward_out", "r", "d", "n", "u")), []),
        outputs=sum(map(each, ("gain_in", "feedforward_in", "weighted_error", "weighted_control",
                               "m")), []))


def lift(system: control.StateSpace, samples_per_tick: int,
         delay_ticks: int = 1) -> control.StateSpace:
    """Lift a fast discrete system to the tick, with averaging and computing time.

    The voltage that the controller decides in tick k is held over tick k + `delay_ticks`: 1 if a
    node answers by a message, 0 if the stage evaluates the feedback by itself. Its input in tick k
    is the mean of the samples of tick k - 1. The system is strictly proper. The states of the
    result are those of the system at the start of the tick, the known means, the acting voltages.
    """
    a, b, c = lift_matrices(system.A, system.B, system.C, samples_per_tick, delay_ticks)
    return control.ss(a, b, c, 0.0, system.dt * samples_per_tick)
