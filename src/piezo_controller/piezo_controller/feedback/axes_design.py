# SPDX-License-Identifier: BSD-3-Clause
"""Design of one feedback for several axes, whose plant is the coupled model at the tick's rate."""

import math
from dataclasses import replace
from itertools import product

import control
import numpy as np

from piezo_common.arrays import FloatArray
from piezo_controller.feedback.feedback_design import UnstableLoop, h_infinity_feedback
from piezo_controller.feedback.loop_measures import measure_axes_loop
from piezo_controller.feedback.multirate_feedback import observer_gain
from piezo_controller.feedback.robustness import PARAMETER_ERROR, PlantErrors
from piezo_controller.feedback.synthesis.dk_iteration import tick_frequencies
from piezo_controller.feedback.synthesis.generalised_plant import lift, secant_gain_range
from piezo_controller.feedback.synthesis.h_infinity import is_stable, reduce_order
from piezo_controller.feedback.synthesis.structured_singular_value import sampled_response
from piezo_controller.feedback.synthesis.weights import DesignWeights
from piezo_models.axes.actuator import Actuator
from piezo_models.axes.coupled import CoupledModel
from piezo_models.feedback_law.axes_law import AxesLaw
from piezo_models.feedback_law.feedback_law import DeclaredPlant, LinearBlock

NOT_SEEN = 1e-4
"""Change of the response, relative to the static one, by states that are left out of the design."""


def design_axes_feedback(model: CoupledModel, weights: DesignWeights, model_sha256: str = "",
                         reduce: bool = True) -> AxesLaw:
    """Design the feedback for a model of several axes, for a stage that evaluates it by itself.

    The weights apply to each axis as to a single one. The voltages are scaled by the static gains,
    so that they apply to stages of any gain. The period of the weights is that of the tick, a
    multiple of the model's. With `reduce`, the order is lowered if that costs next to nothing. The
    hash of the model's file is kept with the controller.

    The report of the law holds ``method``, ``delay_ticks``, ``scaling``, ``gamma``, ``mu``,
    ``mu_history``, ``order``, ``order_before_reduction``, ``hysteresis_gain_spread`` (the largest),
    and the measures of `measure_axes_loop`.

    Raise NoController if the weights cannot be satisfied, UnstableLoop if the loop is not stable at
    every combination of the lowest and highest gains, and ValueError if the tick is no multiple of
    the model's sample period.
    """
    tick_s = weights.sample_period_s
    plant, gains = scaled_plant(model, tick_s)
    points = np.exp(2j * np.pi * tick_s * tick_frequencies(tick_s))
    wanted = sampled_response(plant, points)
    seen = reduce_order(plant, lambda candidate: np.abs(
        sampled_response(candidate, points) - wanted).max() <= NOT_SEEN)
    controller, found = h_infinity_feedback(seen, 1.0, weights, "constant", reduce)
    spreads = gain_spreads(model)
    corners = 1.0 + spreads * np.array([*product((-1.0, 0.0, 1.0), repeat=len(gains))])
    for corner in corners:
        if not is_stable(control.feedback(
                plant * np.diag(corner) * controller, np.eye(len(gains)))):
            raise UnstableLoop("the loop is not stable for every gain of the hysteresis: lower "
                               "--disturbance-hz, or change the weights")
    report = {"method": "h_infinity", "delay_ticks": 0, **found, "order": controller.nstates,
              "hysteresis_gain_spread": float(spreads.max()),
              **measure_axes_loop(plant, controller, model.axes)}
    controller = np.diag(1.0 / gains) * controller
    linear = linear_part(model) * np.diag(1.0 / gains)
    return AxesLaw(
        model.axes, model.sample_period_s, round(tick_s / model.sample_period_s),
        LinearBlock(controller.A, controller.B, controller.C, controller.D),
        observer_gain(controller),
        DeclaredPlant(LinearBlock(linear.A, linear.B, linear.C, linear.D), gains * corners),
        model.operating_displacement_um, report, weights.model_dump(), model_sha256)


def scaled_plant(model: CoupledModel, tick_s: float) -> tuple[control.StateSpace, FloatArray]:
    """Return the plant that the feedback is designed for, at the tick's rate, and its gains.

    The plant leads from the static displacements that the voltages decided in a tick would cause,
    to the mean displacements of the tick before (um per um); the voltages act at once. The gains,
    (n,), are the displacement of each axis for its own voltage (um/V), by the modes and the nominal
    gain of the hysteresis. Raises ValueError if the tick is no multiple of the model's sample
    period.
    """
    samples = round(tick_s / model.sample_period_s)
    if not samples or not math.isclose(samples * model.sample_period_s, tick_s, rel_tol=1e-9):
        raise ValueError(f"the tick of {tick_s:g} s is no multiple of the model's sample period of "
                         f"{model.sample_period_s:g} s: identify with the stage's sample rate")
    gains = static_gains_um_per_v(model)
    return lift(linear_part(model) * np.diag(1.0 / gains), samples, 0), gains


def static_gains_um_per_v(model: CoupledModel) -> FloatArray:
    """Return the displacement of each axis for its own voltage, without creep, (n,)."""
    gains: FloatArray = gain_ranges(model).mean(axis=1) * model.response(0.0)[0].real.diagonal()
    return gains


def linear_part(model: CoupledModel) -> control.StateSpace:
    """Return modes and creep at the model's rate, with the nominal gains of the hysteresis."""
    linear = model.to_control()
    if model.actuators:
        linear = linear * control.append(*(
            each.creep_system(model.sample_period_s) for each in model.actuators))
    if np.any(linear.D):  # a stage takes a sample before its voltage acts
        one, none = np.eye(len(model.axes)), np.zeros((len(model.axes),) * 2)
        linear = (control.ss(linear.A, linear.B, linear.C, none, linear.dt)
                  + control.ss(none, one, linear.D, none, linear.dt))
    return linear * np.diag(gain_ranges(model).mean(axis=1))


def gain_ranges(model: CoupledModel) -> FloatArray:
    """Return the lowest and highest gain of the hysteresis of each axis at mid-travel, (n, 2).

    They are relative to the mean gain over its range.
    """
    return np.array([_gain_range(each) for each in model.actuators]
                    or np.ones((len(model.axes), 2)))


def _gain_range(actuator: Actuator) -> FloatArray:
    if actuator.hysteresis is None:
        return np.ones(2)
    gains = np.array(secant_gain_range(actuator.hysteresis)) / actuator.slope_um_per_v
    return gains if actuator.bouc_wen is None else gains * actuator.bouc_wen.gain_range


def gain_spreads(model: CoupledModel) -> FloatArray:
    """Return the part by which the gain of each axis may differ from its nominal value, (n,)."""
    ranges = gain_ranges(model)
    return ranges[:, 1] / ranges.mean(axis=1) - 1.0


def axes_plant_errors(model: CoupledModel, tick_s: float) -> PlantErrors:
    """Return the plants of `scaled_plant` with gains within their spread, and errors of all modes.

    The frequency, the damping ratio and the static share of a mode are off by up to
    `PARAMETER_ERROR`.
    """
    axes = len(model.axes)

    def plant_of(errors: FloatArray) -> control.StateSpace:
        gains, of_modes = np.split(errors, [axes])
        off = with_mode_errors(model, PARAMETER_ERROR * of_modes.reshape(3, -1))
        varied = (1.0 + gain_spreads(model) * gains) / static_gains_um_per_v(model)
        return lift(linear_part(off) * np.diag(varied), round(tick_s / model.sample_period_s), 0)

    return PlantErrors(plant_of, axes + 3 * model.poles_rad_per_s.size)


def with_mode_errors(model: CoupledModel, errors: FloatArray) -> CoupledModel:
    """Return the model with relative errors of frequency, damping and static share of each mode.

    The errors have the shape (3, K).
    """
    frequency, damping, share = 1.0 + errors
    poles = model.poles_rad_per_s
    moved = frequency * np.where(
        poles.imag > 0.0, damping * poles.real + 1j * poles.imag, poles.real)
    period_s = model.sample_period_s
    kept = share * (1.0 - np.exp(moved * period_s)) / (1.0 - np.exp(poles * period_s))
    return replace(model, poles_rad_per_s=moved,
                   residues_um_per_v=kept[:, None, None] * model.residues_um_per_v)
