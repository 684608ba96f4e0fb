# SPDX-License-Identifier: BSD-3-Clause
"""The free parameters of a model in a joint fit, and the derivatives with respect to them.

The free parameters are logarithms of the rates and sizes of the creep and of the parameters of the
dynamics, factors of the density on a surface, and additions to the reversible part of the
hysteresis. The displacement is linear in the last two. The pole and zero of a creep pair are so
close that they change together: see `piezo_models.linear.creep_errors`.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import chain
from typing import Any

import control
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array

from piezo_common.arrays import FloatArray
from piezo_common.side_by_side import side_by_side
from piezo_identification.estimators.estimate import propagated
from piezo_identification.fitting.parameter_sensitivities import (
    factor_surfaces,
    responses_at,
    sensitivity_systems,
)
from piezo_identification.simulation.sampled_response import (
    behind_lags,
    leading_lags,
)
from piezo_identification.simulation.simulated_recording import SimulatedRecording
from piezo_models.cascade import StageModel
from piezo_models.effects import Effect
from piezo_models.effects.lag import Lag
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.connections import in_series, matrices_of, scaled, with_all_outputs
from piezo_models.linear.creep_errors import creep_error_map
from piezo_models.linear.dynamics import CreepDynamics
from piezo_models.linear.dynamics_vector import (
    dynamics_of_vector,
    dynamics_vector,
    split_dynamics_vector,
)


@dataclass(frozen=True)
class FreeWidths:
    """Prior widths of a joint fit: wide, as the recordings of the identification are refitted."""

    logarithm: float = 0.2
    """Width of the logarithm of a rate or size of the creep, or of a parameter of the dynamics."""
    factor: float = 0.2
    """Width of a factor of the density."""
    reversible: float = 0.05
    """Width of the reversible part at a knot of the voltage, relative to the mean gain of the
    hysteresis."""
    reversible_knots: int = 4
    curve_knots: int = 8
    """Number of knots where there is no density: the reversible part is then the whole curve."""


WIDTHS = FreeWidths()

KEPT_SAMPLES = 2_000_000
"""Largest total number of samples for which the outputs of some 40 pieces of the hysteresis are
cached: 0.6 GB."""

KEPT = 4
"""Number of hystereses whose shapes are cached."""

SMALL = 1e-6
"""Step of the derivative through effects behind the linear part, relative to the travel."""


def free_sensitivities(part: SimulatedRecording, rows: NDArray[np.intp],
                       about: StageModel | None = None,
                       pieces_um: Iterable[FloatArray] | None = None,
                       of_pieces_um: FloatArray | None = None) -> FloatArray:
    """Return the change of the displacement when each free parameter changes by its prior width.

    The result is (n, parameters), with columns in the order of the changes that `changed_model`
    takes. The recording is simulated with a model that includes its effects: the changes pass
    through them. `about` is the model from which `changed_model` derived the model of `part`, by
    default that model itself.

    `pieces_um`, (N,) each, are results of `piece_outputs_um`. A lag ahead of the hysteresis is
    applied behind the pieces, too, where its effect on them is nearly the same. They are not used
    if another effect acts on the voltage. `of_pieces_um`, (n, pieces), is the change of the
    displacement with each piece, if it is known from a similar model.
    """
    model = part.model
    given = model if about is None else about
    lags, others = leading_lags(_behind(model), part.samples_per_mean)
    linear, delay_s = behind_lags(model.linear(), lags)
    at_once = all(effect.acts_at_once(part.sample_period_s) for effect in others)

    ahead, of_pieces = model.effects_at("voltage"), linear
    if pieces_um is None or not all(isinstance(effect, Lag) for effect in ahead):
        pieces_um = piece_outputs_um(part, given)
    else:
        of_pieces = control.ss(*in_series(
            [*(matrices_of(effect.lag()) for effect in ahead), matrices_of(linear)]))
    if of_pieces_um is not None:
        pieces_um = ()
    moved = _moved_systems(model, lags)
    if at_once:
        changes = np.column_stack([
            *(responses_at(part, system, [part.input_um], rows, delay_s) for system in moved),
            responses_at(part, of_pieces, pieces_um, rows, delay_s)])
        if others:
            displacement_um = part.respond(linear, part.input_um, delay_s)
            changes *= _slope(others, part, displacement_um, rows)[:, None]
    else:
        displacement_um = part.respond(linear, part.input_um, delay_s)
        changes_um = chain(
            (part.respond(system[number, 0], part.input_um, delay_s)
             for system in moved for number in range(system.noutputs)),
            (part.respond(of_pieces, piece_um, delay_s) for piece_um in pieces_um))
        changes = np.column_stack([np.empty((rows.size, 0)), *_through(
            others, part, displacement_um, changes_um, rows)])
    return changes if of_pieces_um is None else np.hstack([changes, of_pieces_um])


def _moved_systems(model: StageModel, lags: Sequence[Effect]) -> list[control.StateSpace]:
    """Return the changes of the linear part for one width of each of its parameters, as outputs.

    One system has the changes that follow the whole linear part, and another those that follow the
    part of it that passes the model's own modes.
    """
    linear = matrices_of(behind_lags(model.linear(), lags)[0])
    parallel = model.effects_at("modes")
    # With additional modes, the model's own modes contribute only a part of the displacement.
    own_modes = replace(model, effects=tuple(
        effect for effect in model.effects if effect not in parallel))
    share = 1.0 - sum(mode.participation for mode in parallel)
    of_modes = scaled(share, matrices_of(behind_lags(own_modes.linear(), lags)[0]))
    ahead_of_modes = 2 * len(model.creep.poles_rad_per_s) + (model.dynamics.time_constant_s > 0.0)
    sensitivities = [*map(matrices_of, sensitivity_systems(model.creep, model.dynamics))]
    logarithms, systems = _logarithms(model).T, []
    for ahead, used in ((linear, slice(ahead_of_modes)), (of_modes, slice(ahead_of_modes, None))):
        if sensitivities[used]:
            a, b, c, d = in_series([ahead, with_all_outputs(sensitivities[used])])
            weights = logarithms[used, used]
            systems.append(control.ss(a, b, weights @ c, weights @ d))
    return systems


def piece_outputs_um(part: SimulatedRecording, about: StageModel) -> Iterator[FloatArray]:
    """Yield the change of the hysteresis output for one width of each of its parameters, (N,)."""
    return map(part.hysteresis_output_um, pieces_of(about.hysteresis))


def kept_pieces_um(
    parts: Sequence[SimulatedRecording], about: StageModel,
) -> list[list[FloatArray]] | None:
    """Return the `piece_outputs_um` of each recording; None for too many samples."""
    if sum(part.time_s.size for part in parts) > KEPT_SAMPLES:
        return None
    return side_by_side(lambda part: list(piece_outputs_um(part, about)), parts)


def decay_sensitivities(part: SimulatedRecording, rows: NDArray[np.intp], sizes: FloatArray,
                        about: StageModel) -> FloatArray:
    """Return the change of the initial creep when each free parameter changes by its prior width.

    The initial creep decays at the rates of the creep poles. The n columns are those of creep and
    dynamics. `sizes`, (1 + creep pairs or more,), are the coefficients of the nuisance regressors.
    """
    poles = np.array(part.model.creep.poles_rad_per_s)
    decays = part.nuisance_regressors(rows)[:, 1 : 1 + poles.size]
    by_pole = -sizes[1 : 1 + poles.size] * decays * np.outer(part.time_s[rows], poles)
    return by_pole @ _logarithms(part.model)[: poles.size]


def changed_model(model: StageModel, changes: FloatArray) -> StageModel:
    """Return a model with its free parameters changed.

    The changes, (n,), are in prior widths and in the order of `free_sensitivities`; they are empty
    for no change. Those of the hysteresis, which come last, may be left out.
    """
    if not changes.size:
        return model
    dynamics, hysteresis = model.dynamics, model.hysteresis
    pairs = len(model.creep.poles_rad_per_s)
    physical = _physical(model)
    # Only an absent lag is zero.
    count = np.count_nonzero(physical)
    factors = np.exp(WIDTHS.logarithm * changes[:count])
    poles, zeros, rest = np.split(physical, [pairs, 2 * pairs])
    ratios = 1.0 + (zeros - poles) / poles * factors[pairs : 2 * pairs]
    # Creep against the voltage may grow, but its zero stays in the left half plane.
    zeros = poles * factors[:pairs] * np.maximum(
        ratios, 0.5 * np.minimum(zeros / poles, 1.0))
    poles = poles * factors[:pairs]
    rest[rest > 0.0] *= factors[2 * pairs :]
    model = replace(
        model, creep=CreepDynamics(tuple(poles), tuple(zeros)),
        dynamics=dynamics_of_vector(rest, len(dynamics.mode_frequencies_rad_per_s),
                                    len(dynamics.antiresonance_frequencies_rad_per_s)))
    if changes.size == count:
        return model
    surfaces, hats = _shapes(hysteresis)
    factors, additions = np.split(changes[count:], [surfaces.shape[1]])
    surface = 1.0 + WIDTHS.factor * (surfaces @ factors).reshape(
        hysteresis.density_um_per_v2.shape)
    added = WIDTHS.reversible * hysteresis.mean_gain_um_per_v * additions @ hats
    return replace(model, hysteresis=replace(
        hysteresis,
        density_um_per_v2=hysteresis.density_um_per_v2 * np.maximum(surface, 0.0),
        reversible_um_per_v=np.maximum(hysteresis.reversible_um_per_v + added, 0.0)))


def changes_between(model: StageModel, changed: StageModel) -> FloatArray:
    """Return the changes that turn the creep and dynamics of one model into those of another.

    The two models have the same structure. The changes, (n,), are in prior widths and are the first
    of those that `changed_model` takes. They are not finite where no factor exists, as between
    sizes of opposite sign.
    """
    def values(each: StageModel) -> FloatArray:
        poles, zeros = (np.array(values) for values in (
            each.creep.poles_rad_per_s, each.creep.zeros_rad_per_s))
        rest = dynamics_vector(each.dynamics)
        return np.concatenate([poles, (zeros - poles) / poles, rest[rest > 0.0]])

    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.log(values(changed) / values(model)) / WIDTHS.logarithm)


def lowest_changes(hysteresis: PreisachModel) -> FloatArray:
    """Return the changes in widths below which the hysteresis would become negative, (n,)."""
    surfaces, _ = _shapes(hysteresis)
    size = len(hysteresis.density_um_per_v2)
    at_knots = np.interp(_knots(hysteresis), (np.arange(size) + 0.5) / size,
                         hysteresis.reversible_um_per_v)
    return np.concatenate([np.full(surfaces.shape[1], -1.0 / WIDTHS.factor),
                           -at_knots / (WIDTHS.reversible * hysteresis.mean_gain_um_per_v)])


def free_count(model: StageModel) -> int:
    """Return the number of free parameters of a model."""
    surfaces, hats = _shapes(model.hysteresis)
    return int(np.count_nonzero(_physical(model))) + surfaces.shape[1] + len(hats)


def physical_count(model: StageModel) -> int:
    """Return the number of free parameters of creep and dynamics, which come first."""
    return int(np.count_nonzero(_physical(model)))


def physical_deviations(model: StageModel, covariance: FloatArray) -> dict[str, dict[str, Any]]:
    """Return the standard deviations of creep and dynamics, by component and field name.

    The covariance, (n, n), is that of the changes of creep and dynamics, in widths; unknown
    variances are infinite.
    """
    physical = _physical(model)
    free = physical > 0.0
    logarithms = np.zeros(physical.size)
    logarithms[free] = np.sqrt(np.diag(propagated(_logarithms(model), covariance)))
    pairs = len(model.creep.poles_rad_per_s)
    poles, zeros, rest = np.split(physical * logarithms, [pairs, 2 * pairs])
    return {
        "creep": {"poles_rad_per_s": tuple(poles.tolist()), "zeros_rad_per_s": tuple(
            zeros.tolist())},
        "dynamics": split_dynamics_vector(
            rest, len(model.dynamics.mode_frequencies_rad_per_s),
            len(model.dynamics.antiresonance_frequencies_rad_per_s))}


def _physical(model: StageModel) -> FloatArray:
    """Return the parameters of creep and dynamics."""
    creep = model.creep
    return np.concatenate([
        creep.poles_rad_per_s, creep.zeros_rad_per_s, dynamics_vector(model.dynamics)])


def _logarithms(model: StageModel) -> FloatArray:
    """Return the changes of the logarithms of the free parameters for one width of each change."""
    widths = np.eye(int(np.count_nonzero(_physical(model))))
    pair = 2 * len(model.creep.poles_rad_per_s)
    widths[:pair, :pair] = creep_error_map(model.creep)
    return WIDTHS.logarithm * widths


def _behind(model: StageModel) -> tuple[Effect, ...]:
    return (*model.effects_at("displacement"), *model.effects_at("sensor"))


def _slope(effects: Sequence[Effect], part: SimulatedRecording, displacement_um: FloatArray,
           rows: NDArray[np.intp]) -> FloatArray:
    """Return the slopes of instantaneous effects at the displacement, (n,)."""
    step_um = SMALL * np.ptp(displacement_um)
    unmoved_um, moved_um = (
        _behind_effects(effects, part, ahead_um, part.rest_um)[rows]
        for ahead_um in (displacement_um, displacement_um + step_um))
    return np.asarray((moved_um - unmoved_um) / step_um)


def _through(effects: Sequence[Effect], part: SimulatedRecording, displacement_um: FloatArray,
             changes_um: Iterable[FloatArray], rows: NDArray[np.intp]) -> Iterator[FloatArray]:
    """Yield small changes of the displacement after they have passed through effects, each (n,)."""
    unchanged_um = _behind_effects(effects, part, displacement_um, part.rest_um)[rows]
    travel_um = np.ptp(displacement_um)
    for change_um in changes_um:
        step = SMALL * travel_um / max(np.abs(change_um).max(), SMALL)
        moved_um = _behind_effects(effects, part, displacement_um + step * change_um,
                                   part.rest_um + step * change_um[0])
        yield (moved_um[rows] - unchanged_um) / step


def _behind_effects(effects: Sequence[Effect], part: SimulatedRecording, signal_um: FloatArray,
                    rest_um: float) -> FloatArray:
    """Return a displacement after it has passed through effects one after the other, (N,)."""
    for effect in effects:
        signal_um = effect.apply(signal_um, part.sample_period_s, rest_um)
    return signal_um


@lru_cache(maxsize=KEPT)
def pieces_of(hysteresis: PreisachModel) -> tuple[PreisachModel, ...]:
    """Return the change of the hysteresis for one width of each of its parameters.

    They are cached with their tables, because every recording is simulated with them.
    """
    surfaces, hats = _shapes(hysteresis)
    density, nothing = hysteresis.density_um_per_v2, 0.0 * hysteresis.reversible_um_per_v
    gain = WIDTHS.reversible * hysteresis.mean_gain_um_per_v
    shares = [(WIDTHS.factor * density * surface.toarray().reshape(density.shape), nothing)
              for surface in surfaces.T]
    shares += [(0.0 * density, gain * hat) for hat in hats]
    return tuple(replace(hysteresis, density_um_per_v2=density, reversible_um_per_v=reversible,
                         offset_um=0.0) for density, reversible in shares)


@lru_cache(maxsize=KEPT)
def _shapes(hysteresis: PreisachModel) -> tuple[csc_array, FloatArray]:
    """Return the surfaces over the density, (cells, surfaces), and the hats over the voltage.

    They are cached, because fits need them at every step: callers must not change them.
    """
    size = len(hysteresis.density_um_per_v2)
    knots, middles = _knots(hysteresis), (np.arange(size) + 0.5) / size
    hats = np.array([np.interp(middles, knots, hat) for hat in np.eye(knots.size)])
    surfaces = _sparse_surfaces(size)
    present = hysteresis.density_um_per_v2.ravel() != 0.0
    return surfaces[:, surfaces.T @ present.astype(float) > 0.0], hats


def _knots(hysteresis: PreisachModel) -> FloatArray:
    """Return the knots of the reversible part, (k,), with the range scaled to 0 to 1."""
    is_curve = hysteresis.is_line and len(hysteresis.density_um_per_v2) > 1
    return np.linspace(0.0, 1.0, WIDTHS.curve_knots if is_curve else WIDTHS.reversible_knots)


@lru_cache(maxsize=KEPT)
def _sparse_surfaces(size: int) -> csc_array:
    """Return the surfaces over all cells; at most four of them are nonzero at each cell."""
    return csc_array(np.column_stack([surface.ravel() for surface in factor_surfaces(size)]))
