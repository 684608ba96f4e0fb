# SPDX-License-Identifier: BSD-3-Clause
"""Errors of changed models of several axes in the data of a diagnosis.

They are divided by their tolerance: noise and known error of the model.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piezo_common.arrays import BoolArray, ComplexArray, FloatArray
from piezo_identification.axes.axes_response import AxesResponse
from piezo_identification.axes.axis_effects import AxisEffect, ModeOfAxis, all_effects
from piezo_identification.axes.mode_search import ErrorLines, guessed, lines_of
from piezo_identification.axes.predict_axes import (
    SAME_PERIOD,
    circumstances_of,
    decays,
    driven_v,
    predict_several_axes,
    simulated_um,
)
from piezo_identification.axes.spectra import with_rough_deviations
from piezo_identification.axes.whole_axes_fit import STEPS
from piezo_identification.conditioning.sensor_noise import (
    noise_floor_um,
    repeated_period,
    sensor_noise_um,
)
from piezo_identification.diagnosis.response.response_diagnosis import FEWEST_FREQUENCIES
from piezo_identification.fitting.dataset import SPLIT
from piezo_identification.fitting.levenberg_marquardt import descend
from piezo_identification.fitting.regression import SETTINGS
from piezo_models.axes.coupled import CoupledModel
from piezo_models.axes.identified_axes import IdentifiedAxes
from piezo_recorder.reading.axes import AxesRecording
from piezo_recorder.reading.recording import RecordingError

WORTHWHILE = 1e-3
"""Smallest predicted decrease of half the squared errors, in tolerances, for a step of a fit."""


class DiagnosedErrors(ABC):
    """Errors of changed models, and the effects that the data may show.

    Errors may be correlated within a stretch; the stretch of each row is given, (N,). Rows that are
    not `fitted`, (N,), are held out.
    """

    unit = "um"
    not_shown = ""
    """Why the data do not show the gain of an axis; empty if they do."""
    given: dict[str, dict[str, float]]
    """Errors of the given model, as `reported` returns them."""
    noise_um: FloatArray
    """Standard deviation of the noise of each sensor, (n,)."""
    tolerance: FloatArray
    known_squares: FloatArray
    """Squared known error of the model in squared tolerances, broadcast over rows and axes."""

    def __init__(self, identified: IdentifiedAxes, stretch: NDArray[np.intp]) -> None:
        self._identified, self.model, self.stretch = identified, identified.model, stretch
        self.fitted = stretch % SPLIT.held_out != SPLIT.held_out // 2

    @abstractmethod
    def errors_um(self, model: CoupledModel) -> FloatArray:
        """Return the errors of a model, (N, n)."""

    @abstractmethod
    def lines(self, axis: int) -> ErrorLines:
        """Return errors of the given model, and the drive of one axis, at lines of a spectrum."""

    @abstractmethod
    def reported(self, model: CoupledModel) -> dict[str, dict[str, float]]:
        """Return `rms_um` and `e_y_percent` of each axis."""

    def _know(self, noise: FloatArray, model_error: FloatArray) -> None:
        self.tolerance = np.hypot(noise, model_error)
        self.known_squares = (model_error / self.tolerance) ** 2

    def stated_errors(self) -> FloatArray:
        """Return the relative errors on unseen data that the model states, (n,)."""
        return np.array([self._identified.errors.get(axis, {}).get("e_y_percent", 0.0) / 100.0
                         for axis in self.model.axes])

    def effects(self) -> list[AxisEffect]:
        """Return the effects that change anything in the data, with initial values."""
        known = [each for each in all_effects(self.model.axes)
                 if not (self.not_shown and each.name == "gain")]
        return [each for each in [*known, *self._modes()]
                if self.linearised((each,), np.array(each.start))[1].any()]

    def _modes(self) -> list[ModeOfAxis]:
        """Return the mode of each driven axis that explains most of the errors."""
        model, found = self.model, []
        latency_s = model.latency_samples * model.sample_period_s
        delays_s = np.where(np.isfinite(self._identified.delay_deviations_s),
                            self._identified.delays_s, latency_s)
        for number, axis in enumerate(model.axes):
            lines = self.lines(number)
            if np.any(lines.drive):
                found.append(guessed(
                    ModeOfAxis("vibration_mode", axis, "", model.axes,
                               tuple((delays_s - latency_s).tolist())),
                    model.sample_period_s, lines, delays_s))
        return found

    def extended(self, effects: Sequence[AxisEffect], values: FloatArray) -> CoupledModel:
        """Return the model with effects."""
        return reduce(lambda model, each: each[0].applied(model, each[1]),
                      zip(effects, by_effect(effects, values), strict=True), self.model)

    def residual(self, effects: Sequence[AxisEffect], values: FloatArray) -> FloatArray:
        """Return the errors with effects in tolerances, (N, n)."""
        residual: FloatArray = self.errors_um(self.extended(effects, values)) / self.tolerance
        return residual

    def linearised(self, effects: Sequence[AxisEffect],
                   values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the errors, (N, n), and the derivatives of the displacement, (N, n, p)."""
        unmoved, columns = self.residual(effects, values), []
        for number, step in enumerate(joined_values(
                effect.steps(self.model, own) for effect, own in zip(
                    effects, by_effect(effects, values), strict=True))):
            moved = values.copy()
            moved[number] += step
            columns.append((unmoved - self.residual(effects, moved)) / step)
        return unmoved, (np.stack(columns, axis=-1) if columns
                         else np.zeros((*unmoved.shape, 0)))

    def values(self, effects: Sequence[AxisEffect], values: FloatArray,
               rows: BoolArray) -> FloatArray:
        """Return the parameters that fit some rows best, (p,), from initial values."""
        return descend(_Misfit(self, effects, rows), values, STEPS,
                       WORTHWHILE).vector if effects else values


class _Misfit:
    """Half the squared errors at some rows as a function of the values of effects.

    For `low`, `high` and `longest`, (p,), see `levenberg_marquardt.Objective`.
    """

    def __init__(self, errors: DiagnosedErrors, effects: Sequence[AxisEffect],
                 rows: BoolArray) -> None:
        self._errors, self._effects, self._rows = errors, effects, rows
        self.low, self.high = (joined_values(ends) for ends in zip(
            *(effect.bounds(errors.model) for effect in effects), strict=True))
        self.longest = np.full(self.low.size, np.inf)

    def value(self, vector: FloatArray) -> float:
        """Return the function to minimise."""
        return 0.5 * float(np.sum(
            self._errors.residual(self._effects, vector)[self._rows] ** 2))

    def linearised(self, vector: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the errors, (m,), and their derivatives, (m, p)."""
        residual, columns = self._errors.linearised(self._effects, vector)
        return residual[self._rows].ravel(), -columns[self._rows].reshape(-1, vector.size)


class ErrorsInRecording(DiagnosedErrors):
    """Errors of changed models in a recording.

    Offset and decays from before the recording are projected out.
    """

    def __init__(self, identified: IdentifiedAxes, recording: AxesRecording) -> None:
        rows = np.arange(len(recording.voltage_v))
        _check_recording(recording)
        super().__init__(identified, rows * SPLIT.stretches // rows.size)
        model = self.model
        self._recording = recording
        self.given = self.reported(model)
        self._circumstances = circumstances_of(model, recording)
        self._driven = replace(recording, voltage_v=np.tile(
            driven_v(model, recording, self._circumstances), (recording.periods or 1, 1)))
        before = decays(model, recording)
        self._nuisance = np.linalg.svd(np.column_stack([
            np.ones(rows.size), before - before.mean(axis=0)]), full_matrices=False)[0]
        moves_v = np.linalg.norm(recording.voltage_v - recording.voltage_v[0], axis=1)
        # The residual of a wrong model may contain more at high frequencies than the motion.
        self.noise_um = np.array([
            min(sensor_noise_um(measured, moves_v, residual, repeated_period(moves_v)),
                noise_floor_um(measured))
            for measured, residual in zip(recording.displacement_um.T, self.errors_um(model).T,
                                          strict=True)])
        known_um = self.stated_errors() * np.std(recording.displacement_um, axis=0)
        self._know(self.noise_um, np.hypot(
            SETTINGS.model_tolerance * np.ptp(recording.displacement_um, axis=0),
            np.sqrt(np.maximum(known_um**2 - self.noise_um**2, 0.0))))

    def errors_um(self, model: CoupledModel) -> FloatArray:
        """Return the errors of a model, (N, n)."""
        residual_um = self._driven.displacement_um - simulated_um(
            replace(model, actuators=()), self._driven, self._circumstances)
        projected: FloatArray = residual_um - self._nuisance @ (self._nuisance.T @ residual_um)
        return projected

    def lines(self, axis: int) -> ErrorLines:
        """Return errors of the given model, and the drive of one axis, at lines of a spectrum."""
        return lines_of(self._driven.voltage_v[:, axis], self.errors_um(self.model),
                        self.tolerance, self._driven.sample_period_s)

    def reported(self, model: CoupledModel) -> dict[str, dict[str, float]]:
        """Return `rms_um` and `e_y_percent` of each axis."""
        prediction = predict_several_axes(model, self._recording)
        rms_um = np.std(prediction.measured_um - prediction.simulated_um, axis=0)
        axes = self._recording.axes
        return {axis: {"rms_um": float(rms_um[axes.index(axis)]), "e_y_percent": error}
                for axis, error in prediction.e_y_percent().items()}


class ErrorsInResponse(DiagnosedErrors):
    """Errors of changed models in a measured frequency response, per V of the driven axis.

    The rows are real and imaginary parts by line and driven axis. Behind a hysteresis, the response
    to each axis has a further gain and phase, the same at all lines: they depend on the amplitude
    of the measurement, which a response does not contain.
    """

    unit = "um/V"

    def __init__(self, identified: IdentifiedAxes, response: AxesResponse) -> None:
        model, n = identified.model, len(identified.model.axes)
        response = _comparable(identified, response)
        lines = np.arange(response.frequency_hz.size)
        super().__init__(identified, np.repeat(
            lines * min(lines.size, SPLIT.stretches) // lines.size, 2 * n))
        self._frequency_hz = response.frequency_hz
        self._creep = np.ones((lines.size, 1, n), dtype=complex)
        for axis, each in enumerate(model.actuators):
            self._creep[:, 0, axis] = each.creep_response(
                response.frequency_hz, model.sample_period_s)
        if any(each.hysteresis for each in model.actuators):
            self.not_shown = ("the gain behind a hysteresis depends on the amplitude, which a "
                              "response does not contain")
        spectra = with_rough_deviations(response)
        self._measured = np.stack([each.motion for each in spectra], axis=2)
        deviation = 1.0 / np.stack([each.weight for each in spectra], axis=2)
        size = np.abs(self._measured)
        known = np.sqrt(
            (SETTINGS.model_tolerance * np.sqrt(np.mean(size**2, axis=(0, 2)))[:, None]) ** 2
            + identified.response_deviation_um_per_v(self._frequency_hz) ** 2
            + (self.stated_errors()[:, None] * size) ** 2
            + (_aliases(response)[:, None, None] * size) ** 2)
        self.noise_um = np.sqrt(np.mean(deviation**2, axis=(0, 2)))
        # A complex error has half of its square in each part.
        noise_of_rows, known_of_rows = (
            np.repeat(each.transpose(0, 2, 1) / np.sqrt(2.0), 2, axis=1).reshape(-1, n)
            for each in (deviation, known))
        self._weight = 1.0 / np.hypot(deviation, known)
        self._know(noise_of_rows, known_of_rows)
        self.given = self.reported(model)

    def _errors(self, model: CoupledModel) -> ComplexArray:
        """Return the errors of a model by line, moving axis and driven axis, (K, n, n)."""
        gain = model.response(self._frequency_hz) * self._creep
        if self.not_shown:
            measured, own = (self._weight * each for each in (self._measured, gain))
            gain = gain * (np.sum(own.conj() * measured, axis=(0, 1))
                           / np.sum(np.abs(own) ** 2, axis=(0, 1)))
        errors: ComplexArray = self._measured - gain
        return errors

    def errors_um(self, model: CoupledModel) -> FloatArray:
        """Return the errors of a model, (N, n)."""
        errors = self._errors(model).transpose(0, 2, 1)
        return np.stack([errors.real, errors.imag], axis=2).reshape(-1, errors.shape[2])

    def lines(self, axis: int) -> ErrorLines:
        """Return errors of the given model, and the drive of one axis, at lines of a spectrum."""
        rates = 2.0 * np.pi * self._frequency_hz
        return ErrorLines(rates, self._creep[:, 0, axis], self._errors(
            self.model)[:, :, axis], 1.0 / self._weight[:, :, axis], float(rates[0]))

    def reported(self, model: CoupledModel) -> dict[str, dict[str, float]]:
        """Return `rms_um`, here of the gain, and `e_y_percent` of each axis."""
        rms = np.sqrt(np.mean(np.abs(self._errors(model)) ** 2, axis=(0, 2)))
        size = np.sqrt(np.mean(np.abs(self._measured) ** 2, axis=(0, 2)))
        return {axis: {"rms_um": float(error), "e_y_percent": float(100.0 * error / whole)}
                for axis, error, whole in zip(model.axes, rms, size, strict=True)}


def _check_recording(recording: AxesRecording) -> None:
    if not np.ptp(recording.voltage_v, axis=0).any():
        raise RecordingError(f"no axis of {recording.name} moves: give a recording of motion")
    for axis, resting in zip(recording.axes, np.ptp(recording.displacement_um, axis=0) == 0.0,
                             strict=True):
        if resting:
            raise RecordingError(f"the displacement of {axis} in {recording.name} is constant: "
                                 "give a recording with the sensors of all axes")
    if len(recording.voltage_v) < SPLIT.held_out * SPLIT.stretches:
        raise RecordingError(f"{recording.name} has {len(recording.voltage_v)} rows: give "
                             f"{SPLIT.held_out * SPLIT.stretches} or more")


def _comparable(identified: IdentifiedAxes, response: AxesResponse) -> AxesResponse:
    """Return a response at the sample rate of a model, if the two can be compared."""
    model, lines = identified.model, response.frequency_hz.size
    if response.axes != model.axes:
        raise ValueError(f"{response.name} has the axes {', '.join(response.axes)}, and the model "
                         f"{', '.join(model.axes)}: give a response of these")
    if lines < FEWEST_FREQUENCIES:
        raise ValueError(f"{response.name} has {lines} frequencies, too few to hold some out: "
                         f"measure at least {FEWEST_FREQUENCIES}")
    if model.softening is not None:
        raise ValueError(f"the modes of the model depend on the amplitude of the voltage, which "
                         f"{response.name} does not contain: give a recording")
    rate_hz = 1.0 / model.sample_period_s
    if response.is_held and abs(response.sample_rate_hz / rate_hz - 1.0) > SAME_PERIOD:
        raise ValueError(f"{response.name} is of samples at {response.sample_rate_hz:g} Hz, and "
                         f"the model of {rate_hz:g} Hz: give a response at this rate")
    return replace(response, sample_rate_hz=rate_hz)


def _aliases(response: AxesResponse) -> FloatArray:
    """Return the size of the aliases that a continuous response lacks, relative to it, (K,).

    Behind the modes, it falls with the second power of the frequency, and its hold with the first.
    """
    alias_hz = response.sample_rate_hz - response.frequency_hz
    return (not response.is_held) * (response.frequency_hz / alias_hz) ** 3


def by_effect(effects: Sequence[AxisEffect], values: NDArray[Any]) -> list[NDArray[Any]]:
    """Return the part of the values that belongs to each effect."""
    return np.split(values, np.cumsum([len(effect.parameters) for effect in effects]))[:-1]


def joined_values(parts: Iterable[FloatArray]) -> FloatArray:
    """Return the values of all effects."""
    return np.concatenate([np.zeros(0), *parts])
