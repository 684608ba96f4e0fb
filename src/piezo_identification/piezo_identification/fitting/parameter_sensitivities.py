# SPDX-License-Identifier: BSD-3-Clause
"""Sensitivities of a simulated displacement to the parameters of the model."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import chain

import control
import numpy as np
from numpy.typing import NDArray

from piezo_common.arrays import FloatArray
from piezo_identification.simulation.simulated_recording import SimulatedRecording
from piezo_models.cascade import StageModel
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.connections import in_series, matrices_of, with_all_outputs
from piezo_models.linear.creep_errors import creep_error_map
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics


@dataclass(frozen=True)
class PriorWidths:
    """Prior widths of the parameters of an identified model, as logarithms."""

    dynamics_and_density: float = 0.005
    """Width of the time constant, the modes, and the surface that multiplies the density."""
    creep: float = 0.05
    """Width of the rates and sizes of the creep: a recording covers few of its time constants."""
    reversible: float = 0.02
    """Width of the reversible part of the gain, which only small loops distinguish from the
    rest."""
    middle_knots: int = 3
    span_knots: int = 4
    """Knots of the surface that multiplies the density: few, so that it stays smooth."""
    near_diagonal: tuple[tuple[float, float], ...] = ((0.005, 0.2), (0.015, 0.05), (0.05, 0.02))
    """Further factors of the density near its diagonal: the span over which each decays, relative
    to the voltage range, and its width. Small spans are the least certain, because an
    identification crosses them on its way to large ones. Chosen on seed 304 of
    the short cases of `diagnose_suite`."""


WIDTHS = PriorWidths()

MIDDLE_KNOTS, SPAN_KNOTS = 4, 8
"""Knots of the bilinear surface that multiplies the density."""


def parameter_sensitivities(part: SimulatedRecording, rows: NDArray[np.intp]) -> FloatArray:
    """Return the change of the displacement when each parameter changes by its prior width.

    The result is (n, parameters), with columns in the order of the changes that `perturbed` takes.
    """
    model = part.model
    linear = model.linear()
    sensitivities = [*map(matrices_of, sensitivity_systems(model.creep, model.dynamics))]
    systems = [control.ss(*in_series([matrices_of(linear), with_all_outputs(sensitivities)]))
               ] if sensitivities else []
    without_offset = replace(model.hysteresis, offset_um=0.0)
    unchanged = np.zeros(len(without_offset.density_um_per_v2))
    multiplied = [_times(without_offset, surface, np.diagonal(surface))
                  for surface in _smooth_surfaces(model)]
    multiplied += [_times(without_offset, surface, unchanged) for surface in _near_surfaces(model)]
    reversible_um, given_um = map(
        part.hysteresis_output_um, (_traded(model.hysteresis, 1.0), model.hysteresis))
    return np.column_stack([
        *(responses_at(part, system, [part.input_um], rows) for system in systems),
        responses_at(part, linear, chain(map(part.hysteresis_output_um, multiplied),
                                         [reversible_um - given_um]), rows),
    ]) @ _width_map(model)


def responses_at(part: SimulatedRecording, system: control.StateSpace,
                 inputs_um: Iterable[FloatArray], rows: NDArray[np.intp],
                 delay_s: float = 0.0) -> FloatArray:
    """Return all outputs of a system at some rows for inputs of equal length, (n, columns)."""
    columns, sampled = [np.empty((rows.size, 0))], None
    for input_um in inputs_um:
        if sampled is None:
            sampled = part.sampled(system, delay_s, input_um.size // part.time_s.size)
        columns.append(sampled.response_at(input_um, rows))
    return np.column_stack(columns)


def perturbed(model: StageModel, changes: FloatArray) -> StageModel:
    """Return the model with its parameters multiplied by factors.

    The changes, (n,), are in prior widths and in the order of `parameter_sensitivities`.
    """
    changes = _width_map(model) @ changes
    used = 0

    def factors(values: Sequence[float]) -> tuple[float, ...]:
        nonlocal used
        used += len(values)
        return tuple(np.array(values) * np.exp(changes[used - len(values) : used]))

    creep = type(model.creep)(
        factors(model.creep.poles_rad_per_s), factors(model.creep.zeros_rad_per_s)
    )
    dynamics = model.dynamics
    lag_s = factors((dynamics.time_constant_s,) if dynamics.time_constant_s > 0.0 else ())
    dynamics = type(dynamics)(
        lag_s[0] if lag_s else 0.0, factors(dynamics.mode_frequencies_rad_per_s),
        factors(dynamics.damping_ratios), factors(dynamics.antiresonance_frequencies_rad_per_s),
        factors(dynamics.antiresonance_damping_ratios),
    )
    near = _near_surfaces(model)
    smooth = 1.0 + np.tensordot(
        changes[used : -1 - len(near)], _smooth_surfaces(model), axes=1)
    surface = smooth + np.tensordot(changes[-1 - len(near) : -1], near, axes=1)
    hysteresis = _times(model.hysteresis, np.maximum(surface, 0.0),
                        np.maximum(np.diagonal(smooth), 0.0))
    hysteresis = _traded(hysteresis, changes[-1])
    return replace(model, creep=creep, dynamics=dynamics, hysteresis=hysteresis)


def _width_map(model: StageModel) -> FloatArray:
    """Return the logarithms of the parameter factors for a change of each by one width."""
    pairs = len(model.creep.poles_rad_per_s)
    dynamics = model.dynamics
    others = (
        (dynamics.time_constant_s > 0.0) + 2 * len(dynamics.mode_frequencies_rad_per_s)
        + 2 * len(dynamics.antiresonance_frequencies_rad_per_s)
        + len(_smooth_surfaces(model)) + len(WIDTHS.near_diagonal) + 1
    )
    widths = WIDTHS.dynamics_and_density * np.eye(2 * pairs + others)
    widths[-1, -1] = WIDTHS.reversible
    widths[: 2 * pairs, : 2 * pairs] = WIDTHS.creep * creep_error_map(model.creep)
    return widths


def _smooth_surfaces(model: StageModel) -> FloatArray:
    """Return the change of the factor of each cell when each knot changes by one."""
    size = len(model.hysteresis.density_um_per_v2)
    return factor_surfaces(size, WIDTHS.middle_knots, WIDTHS.span_knots)


def _near_surfaces(model: StageModel) -> FloatArray:
    """Return the change of the factor of each cell near the diagonal, scaled to one prior width.

    The reversible part is not changed.
    """
    size = len(model.hysteresis.density_um_per_v2)
    rising, falling = np.indices((size, size))
    return np.array([
        width / WIDTHS.dynamics_and_density * np.tril(np.exp((falling - rising) / (span * size)))
        for span, width in WIDTHS.near_diagonal])


def _traded(hysteresis: PreisachModel, part: float) -> PreisachModel:
    """Make a fraction of the gain of the hysteresis over the whole range reversible.

    A negative fraction makes at most the whole reversible part irreversible.
    """
    gain_um_per_v, reversible = hysteresis.mean_gain_um_per_v, hysteresis.reversible_um_per_v
    rest = np.maximum(gain_um_per_v - reversible, np.finfo(float).eps * gain_um_per_v)
    part = max(part, -float(np.min(reversible / rest)))
    return replace(
        hysteresis, density_um_per_v2=hysteresis.density_um_per_v2 * (1.0 - part),
        reversible_um_per_v=np.maximum(
            reversible * (1.0 - part) + part * gain_um_per_v, 0.0),
    )


def _times(hysteresis: PreisachModel, surface: FloatArray,
           diagonal: FloatArray) -> PreisachModel:
    """Multiply the density by a surface, and the reversible part by its diagonal."""
    return replace(
        hysteresis, density_um_per_v2=hysteresis.density_um_per_v2 * surface,
        reversible_um_per_v=hysteresis.reversible_um_per_v * diagonal)


def sensitivity_systems(
    creep: CreepDynamics, dynamics: ElectricVibrationDynamics,
) -> list[control.StateSpace]:
    """Return systems from the displacement to its derivatives by the logarithms of parameters.

    Each is the derivative of a factor of the transfer function by one of its parameters, divided by
    the factor. The systems are in the order of creep poles, creep zeros, time constant unless it is
    0, mode frequencies, damping ratios, and those of the antiresonances.
    """
    def first_order(rate: float, gain: float, direct: float = 0.0) -> control.StateSpace:
        return control.ss([[-rate]], [[rate]], [[gain]], [[direct]])

    def second_order(
        frequency: float, damping: float, position: float, velocity: float, direct: float,
    ) -> control.StateSpace:
        return control.ss(
            [[0.0, frequency], [-frequency, -2.0 * damping * frequency]], [[0.0], [frequency]],
            [[position, velocity]], [[direct]],
        )

    systems = [first_order(pole, -1.0) for pole in creep.poles_rad_per_s]
    systems += [first_order(zero, 1.0) for zero in creep.zeros_rad_per_s]
    if dynamics.time_constant_s > 0.0:
        systems.append(first_order(1.0 / dynamics.time_constant_s, 1.0, -1.0))
    for frequencies, dampings, sign in (
        (dynamics.mode_frequencies_rad_per_s, dynamics.damping_ratios, 1.0),
        (dynamics.antiresonance_frequencies_rad_per_s, dynamics.antiresonance_damping_ratios, -1.0),
    ):
        pairs = list(zip(frequencies, dampings, strict=True))
        systems += [
            second_order(w, d, -2.0 * sign, -2.0 * sign * d, 2.0 * sign) for w, d in pairs
        ]
        systems += [second_order(w, d, 0.0, -2.0 * sign * d, 0.0) for w, d in pairs]
    return systems


@lru_cache(maxsize=4)
def factor_surfaces(
    size: int, middle_knots: int = MIDDLE_KNOTS, span_knots: int = SPAN_KNOTS,
) -> FloatArray:
    """Return surfaces over the cells of a density that sum to one.

    They are bilinear between knots in the mean of the thresholds and in the square root of their
    span: a density changes fastest near the diagonal, where the knots are closest. With `size`
    cells along each threshold, the surfaces are (surfaces, size, size), and lower triangular.
    """
    alpha, beta = np.indices((size, size))
    # A cell on the diagonal is a triangle, whose centroid is off the diagonal.
    span = np.where(alpha == beta, 1.0 / 3.0, alpha - beta) / size

    surfaces = [
        np.tril(middle_hat * span_hat)
        for middle_hat in _hats(0.5 * (alpha + beta + 1) / size, middle_knots)
        for span_hat in _hats(np.sqrt(np.maximum(span, 0.0)), span_knots)
    ]
    return np.array([surface for surface in surfaces if surface.any()])


def _hats(position: FloatArray, knots: int) -> list[FloatArray]:
    """Return piecewise linear functions of a position from 0 to 1 that sum to one."""
    return [np.maximum(0.0, 1.0 - np.abs(position * (knots - 1) - knot)) for knot in range(knots)]
