# SPDX-License-Identifier: BSD-3-Clause
"""Electric and vibration dynamics by ARMAX (thesis 3.4.2, 4.5)."""

from typing import Any

import numpy as np
from scipy.signal import lfilter

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_identification.conditioning.creep_removal import remove_creep
from piezo_identification.conditioning.waveforms import square_wave
from piezo_identification.estimators.armax.armax import Armax, fit_armax
from piezo_identification.estimators.dynamics.fast_signals import drift_basis, played_at_the_clock
from piezo_identification.estimators.dynamics.multisine import hysteresis_and_displacement
from piezo_identification.estimators.dynamics.pole_search import dynamics_of_poles
from piezo_identification.estimators.dynamics.square_wave import WARM_UP_S
from piezo_identification.estimators.estimate import (
    Estimate,
    dynamics_vector,
    order_trial,
    split_dynamics_vector,
)
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_recorder.reading.recording import Recording

MOST_MODES = 4
"""Vibration modes beyond which the search for their number ends: polynomials of more coefficients
hold no more at fast sampling."""


def estimate_dynamics_armax(
    recording: Recording, creep: CreepDynamics, hysteresis: PreisachModel | None = None,
    orders: tuple[int, int, int] | None = None, mode_count: int | None = None,
) -> Estimate:
    """Estimate the electric lag and the vibration modes by an ARMAX model.

    The creep is removed by its inverse. Of a square wave, the hysteresis makes an offset and a
    gain; of any other input, an identified hysteresis tells what enters the dynamics.

    Parameters
    ----------
    recording : Recording
        At the full sample clock.
    hysteresis : PreisachModel, optional
        Needed unless the voltage is a square wave.
    orders : (int, int, int), optional
        Coefficients na, nb and nc, such as the thesis' (5, 6, 5) or (5, 1, 5); by default equal
        ones, odd, as high as the Bayesian information criterion justifies.
    mode_count : int, optional
        How many of the modes to keep, na being as high as they need at least; poles that add
        least to the response are dropped. By default all: (na - 1) / 2.

    Returns
    -------
    Estimate
        Its model is an `ElectricVibrationDynamics`; its order is na.

    Raises
    ------
    ValueError
        If the recording has gaps, is averaged or too short, or does not suit the hysteresis, or
        the orders are too low for the modes.
    """
    input, output, drift, sample_period_s = _signals(recording, creep, hysteresis)
    least = 1 + 2 * (mode_count or 0)
    candidates = [orders] if orders else [
        (n, n, n) for n in range(least, max(least, 2 * MOST_MODES + 1) + 1, 2)]
    best, trials = None, []
    for candidate in candidates:
        armax = fit_armax(input, output, *candidate, drift)
        trials.append(order_trial(candidate[0], armax.residual, armax.parameters))
        if best is not None and trials[-1].information >= trials[-2].information:
            break
        best = armax
    order = best.autoregressive.size - 1
    mode_count = (order - 1) // 2 if mode_count is None else mode_count
    model, standard_deviations = dynamics_of_armax(best, input, sample_period_s, mode_count)
    return Estimate(model, standard_deviations, order, tuple(trials), orders is not None)


def _signals(
    recording: Recording, creep: CreepDynamics, hysteresis: PreisachModel | None,
) -> tuple[FloatArray, FloatArray, FloatArray, float]:
    """Input, output, drift, and the sample period."""
    if hysteresis is not None:
        signals = hysteresis_and_displacement(recording, hysteresis, creep)
        part = signals.longest
        return (signals.entering_um[part], signals.displacement_um[part], signals.drift[part],
                signals.sample_period_s)
    record = played_at_the_clock(recording)
    begin = round(WARM_UP_S / record.sample_period_s)
    input = square_wave(record).level[begin:]
    if input.size == 0 or np.ptp(input) == 0.0:
        raise ValueError(f"{recording.path} is too short: record several periods")
    output = remove_creep(record.displacement_um, creep, record.sample_period_s)[begin:]
    return input, output, drift_basis(record.time_s, creep)[begin:], record.sample_period_s


def dynamics_of_armax(
    armax: Armax, input: FloatArray, sample_period_s: float, mode_count: int,
) -> tuple[ElectricVibrationDynamics, dict[str, Any]]:
    """Electric lag and modes of an ARMAX model, with standard deviations.

    Parameters
    ----------
    input : ndarray, shape (N,)
        Of the record.
    mode_count : int
        Of the poles, the one lag and the modes that add most to the output are kept.

    Returns
    -------
    model : ElectricVibrationDynamics
    standard_deviations : dict

    Raises
    ------
    ValueError
        If the poles do not suffice.
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
    model = dynamics_of_poles(np.log(kept) / sample_period_s)
    if np.isinf(armax.covariance[:order, :order]).any():
        # The poles depend on all coefficients, and the data do not tell all of those.
        return model, split_dynamics_vector(np.full(1 + 2 * mode_count, np.inf), mode_count)
    centre = vector(denominator)
    values, directions = np.linalg.eigh(armax.covariance[:order, :order])
    # Steps along the axes of the covariance are changes that the data allow.
    axes = directions * np.sqrt(np.maximum(values, 0.0))
    step = 1e-3
    changes = [
        (vector(denominator + np.append(0.0, step * axis)) - centre) / step for axis in axes.T
    ]
    return model, split_dynamics_vector(np.linalg.norm(changes, axis=0), mode_count)


def _strongest_poles(armax: Armax, input: FloatArray, mode_count: int) -> ComplexArray:
    """Discrete poles of the lag and the modes with the largest part in the output."""
    poles = armax.poles().astype(complex)
    # Where poles are not in the open disc or negative, there is no continuous one.
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
            f"an ARMAX model of order {poles.size} shows no lag beside {mode_count} modes: ask "
            "for another order or fewer modes"
        )
    return np.concatenate([real, pairs, pairs.conj()])
