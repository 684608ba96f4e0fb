# SPDX-License-Identifier: BSD-3-Clause
"""Fits of a model with further linear effects to a measured frequency response."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from piezo_common.arrays import BoolArray, ComplexArray, FloatArray
from piezo_common.cancellation import check_cancelled
from piezo_identification.estimators.frequency_response.response_file import FrequencyResponse
from piezo_identification.estimators.frequency_response.response_search import ResponseSearch
from piezo_identification.fitting.dataset import without_recordings
from piezo_identification.fitting.free_parameters import WIDTHS as FREE
from piezo_identification.fitting.free_parameters import changed_model, physical_count
from piezo_identification.fitting.joint_errors import JointErrors
from piezo_identification.fitting.joint_fit import SETTINGS as JOINT
from piezo_identification.fitting.levenberg_marquardt import descend
from piezo_identification.fitting.parameter_sensitivities import WIDTHS as IDENTIFIED
from piezo_identification.fitting.whole_model import WholeFit
from piezo_models.cascade import StageModel
from piezo_models.effects import Effect, Extent


class ResponseProblem:
    """A measured response to which effects are fitted, with a model's creep and dynamics.

    The effects of the given model itself are not changed. The response has no hold, and the sign of
    the model. `held_out`, (N,), is True at the frequencies of the validation set, and `noise` is
    the RMS noise of the gain. `extent` holds the ranges that bound the parameters of effects: a
    mode outside the measured band is a guess.
    """

    def __init__(self, model: StageModel, measured: FrequencyResponse) -> None:
        self.model, self.measured = model, measured
        response = ResponseSearch(measured, has_loss=True).measured_response()
        # A form of the response that no model follows would be taken for noise.
        self._response = replace(
            response, noise=min(response.noise, _noise_of_neighbours(response.weighted)))
        self.held_out: BoolArray = ~response.for_estimation[::2]
        self.noise = float(
            np.sqrt(2.0 * np.mean(response.weight**-2.0)) * self._response.noise)
        low_hz, high_hz = measured.frequency_hz[[0, -1]]
        # Its logarithm may be rounded up.
        within_hz = (1.0 - 1e-12) * high_hz
        self.extent = Extent(np.inf, -np.inf, np.inf, 1.0 / low_hz, 0.5 / within_hz)
        self._dataset = without_recordings(
            replace(model, effects=()), physical_count(model), self.extent)
        self._counts = np.array([response.independent * np.mean(response.for_estimation)])

    def fit(self, effects: Sequence[Effect], steps: int,
            begun: WholeFit | None = None) -> WholeFit:
        """Fit guessed effects, creep and dynamics in at most so many steps; 0 for them as they are.

        The initial creep and dynamics are those of the fit `begun`, or of the given model.
        """
        check_cancelled()
        no_rows = np.zeros(0, dtype=bool)
        errors = JointErrors(
            self._dataset, no_rows, no_rows, 0, effects, frozenset(), held=self.model.effects,
            physical_width=IDENTIFIED.dynamics_and_density / FREE.logarithm,
            responses=[self._response])
        changes = np.zeros(errors.count) if begun is None else begun.vector[: errors.count]
        descent = descend(errors, errors.vector(changes, effects), steps, JOINT.worthwhile)
        found = errors.effects_at(descent.vector)[: len(effects)]
        model = changed_model(self.model, descent.vector[: errors.count])
        return WholeFit.of(errors, descent, self._counts, replace(
            model, effects=(*self.model.effects, *found)))

    def added(self, fit: WholeFit) -> tuple[Effect, ...]:
        """Return the effects that a fit has in addition to those of the given model."""
        return fit.model.effects[len(self.model.effects) :]

    def parted(self, fit: WholeFit, number: int) -> tuple[Effect, tuple[Effect, ...]]:
        """Return one of the added effects, by its number, and the others."""
        added = self.added(fit)
        return added[number], (*added[:number], *added[number + 1 :])

    def covariance(self, fit: WholeFit) -> FloatArray:
        """Return the covariance of the fitted values of the added effects, (p, p)."""
        count = fit.errors.count
        return fit.errors.covariance_of_all(fit.vector, 0)[count:, count:]

    def weighted_error(self, fit: WholeFit) -> ComplexArray:
        """Return the error of the gain, weighted by the noise of each frequency, (N,)."""
        return self._response.residual(fit.model).view(complex)

    def gain(self, fit: WholeFit) -> ComplexArray:
        """Return the gain of the model of a fit at the measured frequencies, (N,)."""
        return np.asarray(
            self.measured.gain - self.weighted_error(fit) / self._response.weight)

    def over_noise(self, fit: WholeFit) -> float:
        """Return the RMS error on held-out frequencies over noise and accuracy of a good model."""
        (_, held_out), = fit.residual_um
        return float(np.sqrt(np.mean(held_out**2))
                     / np.hypot(self._response.noise, self._response.accuracy))

    def held_out_errors(self, fit: WholeFit) -> dict[str, float]:
        """Return the errors of the gain on held-out frequencies: `rms_um` and `e_y_percent`."""
        measured, modelled = (
            gain[self.held_out] for gain in (self.measured.gain, self.gain(fit)))
        error = np.linalg.norm(measured - modelled)
        return {"rms_um": float(error / np.sqrt(measured.size)),
                "e_y_percent": float(100.0 * error / np.linalg.norm(measured))}


def _noise_of_neighbours(gain: ComplexArray) -> float:
    """Return the noise of each part of a gain, (N,), that its third differences show."""
    # They have 20 times the variance of the noise, and a Rayleigh distribution.
    return float(np.median(np.abs(np.diff(gain, 3))) / np.sqrt(40.0 * np.log(2.0)))
