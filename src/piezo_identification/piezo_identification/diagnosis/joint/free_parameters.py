# SPDX-License-Identifier: BSD-3-Clause
"""The parameters of a model that are free in a joint fit, and the model's derivatives by them.

They are logarithms of the parameters of creep and dynamics, factors of the density on a surface,
and additions to the reversible part of the hysteresis; the displacement is linear in the last two.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from piezo_common.arrays import FloatArray
from piezo_identification.diagnosis.residual.simulated_recording import SimulatedRecording
from piezo_identification.estimators.estimate import dynamics_of_vector, dynamics_vector
from piezo_identification.estimators.refinement.sensitivities import (
    factor_surfaces,
    sensitivity_systems,
)
from piezo_models.cascade import StageModel
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics


@dataclass(frozen=True)
class FreeWidths:
    """Prior widths of a joint fit: wide, as the recordings of the identification are fitted again.

    Attributes
    ----------
    logarithm : float
        Of a parameter of creep or dynamics.
    factor : float
        Of a factor of the density.
    reversible : float
        Of the reversible part at a knot of the voltage, over the mean gain of the hysteresis.
    reversible_knots : int
    most : float
        Widths that one step may change a parameter by.
    """

    logarithm: float = 0.2
    factor: float = 0.2
    reversible: float = 0.05
    reversible_knots: int = 4
    most: float = 2.0


WIDTHS = FreeWidths()


def free_sensitivities(part: SimulatedRecording, rows: NDArray[np.intp]) -> FloatArray:
    """Return the change of the displacement with each free parameter, for one of its widths.

    Parameters
    ----------
    part : SimulatedRecording
    rows : array of int
        Samples.

    Returns
    -------
    (n, parameters) array
        For the changes that `changed_model` takes.
    """
    model = part.model
    linear = model.linear()
    columns = [
        WIDTHS.logarithm * part.respond(sensitivity * linear, part.input_um)[rows]
        for sensitivity in sensitivity_systems(model.creep, model.dynamics)]
    columns += [
        part.respond(linear, part.hysteresis_output_um(piece))[rows]
        for piece in _pieces(model.hysteresis)]
    return np.column_stack(columns)


def changed_model(model: StageModel, changes: FloatArray) -> StageModel:
    """Return a model with its free parameters changed.

    Parameters
    ----------
    model : StageModel
    changes : (n,) array
        In widths, in the order of `free_sensitivities`.

    Returns
    -------
    StageModel
    """
    changes = np.clip(changes, -WIDTHS.most, WIDTHS.most)
    creep, dynamics, hysteresis = model.creep, model.dynamics, model.hysteresis
    pairs = len(creep.poles_rad_per_s)
    physical = np.concatenate([
        creep.poles_rad_per_s, creep.zeros_rad_per_s, dynamics_vector(dynamics)])
    # Only a lag that is not there is zero.
    free = physical > 0.0
    count = np.count_nonzero(free)
    physical[free] *= np.exp(WIDTHS.logarithm * changes[:count])
    poles, zeros, rest = np.split(physical, [pairs, 2 * pairs])
    surfaces, hats = _shapes(hysteresis)
    factors, additions = np.split(changes[count:], [len(surfaces)])
    surface = 1.0 + WIDTHS.factor * np.tensordot(factors, surfaces, axes=1)
    added = WIDTHS.reversible * _mean_gain(hysteresis) * additions @ hats
    return replace(
        model, creep=CreepDynamics(tuple(poles), tuple(zeros)),
        dynamics=dynamics_of_vector(rest, len(dynamics.mode_frequencies_rad_per_s),
                                    len(dynamics.antiresonance_frequencies_rad_per_s)),
        hysteresis=replace(
            hysteresis,
            density_um_per_v2=hysteresis.density_um_per_v2 * np.maximum(surface, 0.0),
            reversible_um_per_v=np.maximum(hysteresis.reversible_um_per_v + added, 0.0)))


def _pieces(hysteresis: PreisachModel) -> list[PreisachModel]:
    """Return what one width of each change adds to the hysteresis."""
    surfaces, hats = _shapes(hysteresis)
    density, nothing = hysteresis.density_um_per_v2, 0.0 * hysteresis.reversible_um_per_v
    gain = WIDTHS.reversible * _mean_gain(hysteresis)
    shares = [(WIDTHS.factor * density * surface, nothing) for surface in surfaces]
    shares += [(0.0 * density, gain * hat) for hat in hats]
    return [replace(hysteresis, density_um_per_v2=density, reversible_um_per_v=reversible,
                    offset_um=0.0) for density, reversible in shares]


def _shapes(hysteresis: PreisachModel) -> tuple[FloatArray, FloatArray]:
    """Return the surfaces over the density and the hats over the voltage."""
    size = len(hysteresis.density_um_per_v2)
    knots = np.linspace(0.0, 1.0, WIDTHS.reversible_knots)
    middles = (np.arange(size) + 0.5) / size
    hats = np.array([np.interp(middles, knots, hat) for hat in np.eye(knots.size)])
    surfaces = factor_surfaces(size)
    return surfaces[[bool(np.any(hysteresis.density_um_per_v2 * surface))
                     for surface in surfaces]], hats


def _mean_gain(hysteresis: PreisachModel) -> float:
    low_um, high_um = hysteresis.output_range_um
    return float((high_um - low_um) / (hysteresis.voltage_max_v - hysteresis.voltage_min_v))
