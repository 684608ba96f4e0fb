# SPDX-License-Identifier: BSD-3-Clause
"""By how much each sensor of several axes is late."""

from collections.abc import Sequence

import numpy as np

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_identification.axes.coupled_fit import CoupledFit, equations_of_gains
from piezo_identification.axes.spectra import Spectrum
from piezo_models.axes.coupled import CoupledModel

MOST_LATE = 40
"""Samples by which a sensor may be late: 1 ms at 40 kHz."""

ALIKE = 1.05
"""Ratio of the residuals up to which two latencies explain a motion alike: modes that are not yet
among the poles may gain so much by one that is not there."""

SAME_EVIDENCE = 3.84
"""Twice the logarithm of the likelihood ratio up to which two latencies explain a motion alike once
all modes are known: 95 % of the chi-square distribution of one number."""

MOST_DAMPED = 0.1
"""Damping ratio beyond which a mode's phase shows no delay, as its shape is seldom real."""

POINTS_OF_SAMPLE = 50
"""Delays that are compared within a sample period; the best is interpolated."""


def latencies(spectra: Sequence[Spectrum], fit: CoupledFit) -> np.ndarray:
    """Return the whole samples by which each sensor is late: the fewest with a small residual.

    Of the fit only the lightly damped modes are used: others may represent the delay.
    """
    n, tried = spectra[0].motion.shape[1], np.arange(MOST_LATE)
    steps = fit.numbers.steps
    rates = np.log(steps)
    light = steps[(steps.imag > 0.0) & (-rates.real < MOST_DAMPED * np.abs(rates))]
    if not light.size:
        light = steps
    return np.array([_fewest(*equations_of_gains(spectra, light, output, tried), ALIKE)
                     for output in range(n)])


def further_latencies(spectra: Sequence[Spectrum], fit: CoupledFit) -> np.ndarray:
    """Return the whole samples by which each sensor is later than a fit of all modes assumes.

    They are the fewest that explain the motion as well as any within its errors.
    """
    tried, found = np.arange(MOST_LATE), []
    for output in range(spectra[0].motion.shape[1]):
        rows, targets = equations_of_gains(spectra, fit.numbers.steps, output, tried)
        found.append(_fewest(rows, targets, np.exp(SAME_EVIDENCE / len(rows))))
    return np.array(found)


def _fewest(rows: FloatArray, targets: FloatArray, alike: float) -> int:
    orthogonal = np.linalg.qr(rows)[0]
    residual = np.sum(targets**2, axis=0) - np.sum((orthogonal.T @ targets) ** 2, axis=0)
    return int(np.argmax(residual <= alike * residual.min()))


def sensor_delays(model: CoupledModel, deviations: ComplexArray) -> tuple[FloatArray, FloatArray]:
    """Return the delay (s) of each sensor by the phases of the modes, with its standard deviation.

    The displacement of a lightly damped mode of real shape lags its force by a quarter of a turn at
    its frequency; what it lags more is the delay, alike for all modes in one sensor. The standard
    deviations of the residues, (K, n, n), are given; that of the delay is infinite if no mode shows
    it.
    """
    period_s, poles = model.sample_period_s, model.poles_rad_per_s
    light = (poles.imag > 0.0) & (-poles.real < MOST_DAMPED * np.abs(poles))
    light &= np.abs(poles) * period_s < np.pi
    rates, n = np.abs(poles[light]), len(model.axes)
    steps = np.exp(poles[light] * period_s)
    # Of the continuous mode behind a voltage that is held.
    held = (poles[light] / (steps - 1.0))[:, None, None]
    residues = model.residues_um_per_v[light] * held
    phases = np.angle(1j * residues)
    sizes = np.abs(residues) / np.maximum(np.abs(deviations[light] * held), np.finfo(float).tiny)
    delays_s, deviations_s = np.zeros(n), np.full(n, np.inf)
    span = np.arange(-POINTS_OF_SAMPLE, 2 * POINTS_OF_SAMPLE) * period_s / POINTS_OF_SAMPLE
    for sensor in range(n):
        if not rates.size:
            break
        # The shape of a mode may have either sign.
        agreement = np.cos(2.0 * (phases[:, sensor, :, None] + rates[:, None, None] * span))
        weight = sizes[:, sensor] ** 2
        total = np.einsum("kj,kjs->s", weight, agreement)
        best = span[np.argmax(total)]
        off = 0.5 * np.angle(np.exp(2j * (phases[:, sensor] + rates[:, None] * best)))
        square = float(np.sum(weight * rates[:, None] ** 2))
        step = -float(np.sum(weight * rates[:, None] * off)) / square
        residual = off + rates[:, None] * step
        spread = max(1.0, float(np.sum(weight * residual**2)) / max(residual.size - 1, 1))
        delays_s[sensor] = best + step + model.latency_samples[sensor] * period_s
        deviations_s[sensor] = np.sqrt(spread / square)
    return delays_s, deviations_s
