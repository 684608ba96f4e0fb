# SPDX-License-Identifier: BSD-3-Clause
"""Lags of the amplifiers in front of the hysteresis of each axis, from fast recordings.

The modes contain them as poles. That the hysteresis follows the lagged voltage shows at the turns
of a fast voltage, which it rounds.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import minimize_scalar

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_identification.axes.actuator_drive import with_actuator, with_drive
from piezo_identification.axes.coupled_fit import CoupledFit
from piezo_identification.axes.order_search import fit_of_poles, local_evidence_of
from piezo_identification.axes.spectra import Spectrum, driven_otherwise, reweighted, spectrum_of
from piezo_models.axes.coupled import CoupledModel
from piezo_recorder.reading.axes import AxesRecording

SWEEPS = 2
"""Times that the lag of each axis is sought beside those of the others."""

SPACING = 1.5
"""Ratio of the lags that are tried; the best one is refined, also by the last fit."""


def with_amplifier_lags(model: CoupledModel, steps: ComplexArray,
                        fast: Sequence[AxesRecording]) -> CoupledModel:
    """Return a model with the lags with which its hysteresis explains fast recordings best.

    They are shorter than the period of the lowest mode over 2 pi, and explain so much that the
    evidence grows. The poles of the modes in the z plane, (m,), are kept; all gains are fitted
    again.
    """
    moving = [number for number, each in enumerate(model.actuators) if each.hysteresis and any(
        np.ptp(recording.voltage_v[:, number]) > 0.0 for recording in fast)]
    spectra = [spectrum_of(with_drive(model, each)).advanced(model.latency_samples)
               for each in fast]
    fit = fit_of_poles(spectra, steps)
    spectra = [reweighted(*each) for each in zip(spectra, fit.residual, strict=True)]
    light = np.abs(model.poles_rad_per_s[model.poles_rad_per_s.imag > 0.0])
    shortest_s = model.sample_period_s / SPACING**3  # shorter ones settle within the sample
    longest_s = 1.0 / light.min(initial=np.abs(model.poles_rad_per_s).max())
    tried_s = np.exp(np.arange(np.log(shortest_s), np.log(longest_s), np.log(SPACING)))

    for axis in moving * SWEEPS:
        model = _best_of_axis(model, axis, tried_s, lambda changed: _fit_of(
            changed, spectra, steps, fast))
    return model


def _best_of_axis(model: CoupledModel, axis: int, tried_s: FloatArray,
                  fitted: Callable[[CoupledModel], CoupledFit]) -> CoupledModel:
    """Return the model with the best lag of an axis, or without one."""
    def evidence(lag_s: float) -> float:
        # The lag shows where the modes resonate, where what it explains was taken for noise.
        return local_evidence_of(fitted(_lagging(model, axis, lag_s)))

    best_s = max(tried_s, key=evidence)
    refined_s = float(np.exp(minimize_scalar(
        lambda logarithm: -evidence(np.exp(logarithm)), method="bounded",
        bounds=np.log([best_s / SPACING, best_s * SPACING]), options={"xatol": 0.05}).x))
    cost = 0.5 * np.log(fitted(model).rows)
    # What a lag that settles within the sample explains is no lag, but an error of the model.
    without = max(evidence(0.0), evidence(tried_s[0] / SPACING))
    return _lagging(model, axis, refined_s * (evidence(refined_s) - without > cost))


def _lagging(model: CoupledModel, axis: int, lag_s: float) -> CoupledModel:
    return with_actuator(model, axis, replace(model.actuators[axis], lag_s=float(lag_s)))


def _fit_of(model: CoupledModel, spectra: Sequence[Spectrum], steps: ComplexArray,
            fast: Sequence[AxesRecording]) -> CoupledFit:
    return fit_of_poles([driven_otherwise(spectrum, with_drive(model, each))
                         for spectrum, each in zip(spectra, fast, strict=True)], steps)
