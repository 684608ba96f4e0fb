# SPDX-License-Identifier: BSD-3-Clause
"""Electric and vibration dynamics by ARMAX (thesis 3.4.2, 4.5)."""

from typing import Any

import numpy as np
from scipy.signal import lfilter

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_identification.conditioning.waveforms import slow_branches
from piezo_identification.estimators.dynamics.fast_estimate import WARM_UP_S
from piezo_identification.estimators.dynamics.fast_signals import (
    joined_record,
    played_at_the_clock,
    through_hysteresis,
)
from piezo_identification.estimators.dynamics.pole_search import dynamics_of_poles
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_models.linear.dynamics_vector import dynamics_vector, split_dynamics_vector
from piezo_recorder.reading.recording import Recording
from piezo_studies.baselines.armax import Armax, fit_armax


def estimate_dynamics_armax(
    recording: Recording, creep: CreepDynamics, hysteresis: PreisachModel,
    orders: tuple[int, int, int], mode_count: int,
) -> tuple[ElectricVibrationDynamics, dict[str, Any]]:
    """Estimate lag and modes by an ARMAX model; return them with their standard deviations.

    The orders are (na, nb, nc), such as the thesis' (5, 6, 5) or (5, 1, 5). The creep is removed by
    its inverse; the hysteresis gives the input of the dynamics. Poles that contribute least to the
    response are dropped. ValueError is raised if the recording has gaps, is averaged or too short,
    or does not suit the hysteresis, or if the orders are too low for the modes.
    """
    part = played_at_the_clock(recording)
    entering_um = through_hysteresis(recording, part, hysteresis)
    slow = np.flatnonzero(slow_branches(part.time_s, part.voltage_v))
    begin = max(slow[-1] + 1 if slow.size else 0, round(WARM_UP_S / part.sample_period_s))
    record = joined_record([part], [entering_um], [begin], creep)
    input_um = entering_um[record.kept]
    armax = fit_armax(input_um, record.measured_um, *orders, record.fixed)
    return dynamics_of_armax(armax, input_um, part.sample_period_s, mode_count)


def dynamics_of_armax(
    armax: Armax, input: FloatArray, sample_period_s: float, mode_count: int,
) -> tuple[ElectricVibrationDynamics, dict[str, Any]]:
    """Return the lag and the modes that contribute most to the output, with standard deviations.

    The input, (N,), is that of the record. ValueError is raised if the poles do not suffice.
    """
    denominator = armax.autoregressive
    kept = _strongest_poles(armax, input, mode_count)

    def vector(coefficients: FloatArray) -> FloatArray:
        roots = np.roots(coefficients).astype(complex)
        nearest = []
        for pole in kept:
            nearest.append(roots[np.argmin(np.abs(roots - pole))])
            roots = np.delete(roots, np.argmin(np.abs(roots - pole)))
        return dynamics_vector(dynamics_of_poles(np.log(np.array(nearest)) / sample_period_s))

    order = denominator.size - 1
    model = dynamics_of_poles(np.log(kept.astype(complex)) / sample_period_s)
    if np.isinf(armax.covariance[:order, :order]).any():
        # The poles depend on all coefficients, some of which are not identifiable.
        return model, split_dynamics_vector(np.full(1 + 2 * mode_count, np.inf), mode_count)
    centre = vector(denominator)
    values, directions = np.linalg.eigh(armax.covariance[:order, :order])
    # Differentiate along the axes of the covariance, by standard deviations.
    axes = directions * np.sqrt(np.maximum(values, 0.0))
    step = 1e-3
    changes = [
        (vector(denominator + np.append(0.0, step * axis)) - centre) / step for axis in axes.T
    ]
    return model, split_dynamics_vector(np.linalg.norm(changes, axis=0), mode_count)


def _strongest_poles(armax: Armax, input: FloatArray, mode_count: int) -> ComplexArray:
    """Return the discrete poles of the lag and modes that contribute most to the output."""
    poles = armax.poles().astype(complex)
    # Unstable and negative real poles have no continuous counterpart.
    usable = (np.abs(poles) < 1.0) & ~((poles.imag == 0.0) & (poles.real <= 0.0))
    others = poles[:, None] - poles[None, :] + np.eye(poles.size)
    numerator = np.polyval(armax.input[::-1], 1.0 / poles)
    residues = numerator * poles ** (poles.size - 1) / np.prod(others, axis=1)
    strength = np.array([
        np.std(lfilter([0.0, residue], [1.0, -pole], input)) if allowed else -1.0
        for residue, pole, allowed in zip(residues, poles, usable, strict=True)
    ])
    ranked = poles[np.argsort(-strength)][: np.count_nonzero(usable)]
    pairs = ranked[ranked.imag > 0.0][:mode_count]
    real = ranked[ranked.imag == 0.0][: 1 + 2 * (mode_count - pairs.size)]
    if real.size + 2 * pairs.size < 1 + 2 * mode_count:
        raise ValueError(
            f"an ARMAX model of order {poles.size} shows no lag besides {mode_count} modes: "
            "give another order or fewer modes"
        )
    return np.concatenate([real, pairs, pairs.conj()])
