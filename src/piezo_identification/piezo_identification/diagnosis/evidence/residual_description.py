# SPDX-License-Identifier: BSD-3-Clause
"""Sentences on the residual: where, when, how large, and at which frequencies."""

import numpy as np

from piezo_identification.diagnosis.evidence.residual_tests import (
    dependences,
    spectrum,
    whiteness,
)
from piezo_identification.fitting.noise_estimate import residual_um
from piezo_identification.fitting.regression import Fit, Regression

WORTH_REPORTING = 0.05
"""Smallest share of the residual power related to a quantity for which the quantity is named."""

MOST_OF_IT = 0.1, 0.9
"""Quantiles of the power that limit the named band."""


def describe_residual(regression: Regression, fit: Fit) -> str:
    """Describe the residual of a fit, in one sentence for each recording."""
    return " ".join(_sentence(regression, fit, index)
                    for index in range(len(regression.dataset.simulated)))


def _sentence(regression: Regression, fit: Fit, index: int) -> str:
    part, noise = regression.dataset.simulated[index], regression.noise
    residual = residual_um(regression.dataset, index, fit.effects, noise)
    residual = np.where(noise.outliers[index], 0.0, residual)[part.begin :]
    frequency_hz, density = spectrum(residual, part.sample_period_s)
    power = np.cumsum(density[1:])
    low, high = frequency_hz[1:][np.searchsorted(power, [share * power[-1]
                                                         for share in MOST_OF_IT])]
    peak_hz = frequency_hz[1:][np.argmax(density[1:])]
    found = dependences(residual, part.simulate(fit.effects)[part.begin :],
                        part.voltage_v[part.begin :], part.time_s[part.begin :])
    strongest = max(found, key=lambda dependence: dependence.share)
    worst = part.begin + int(np.argmax(np.abs(residual)))
    text = (
        f"{part.path}: {1e3 * np.sqrt(np.mean(residual**2)):.3g} nm RMS, against "
        f"{1e3 * noise.noise_um[index]:.3g} nm of noise; largest at "
        f"{part.time_s[worst]:.4g} s, {part.voltage_v[worst]:.4g} V; most of it from "
        f"{low:.3g} to {high:.3g} Hz, strongest at {peak_hz:.4g} Hz"
    )
    if strongest.share > WORTH_REPORTING:
        text += (f"; {100 * strongest.share:.0f} % of its power goes with "
                 f"{strongest.quantity.split(' / ')[0]}")
    if whiteness(residual).passed:
        text += "; neighbouring samples are not alike"
    return f"{text}."
