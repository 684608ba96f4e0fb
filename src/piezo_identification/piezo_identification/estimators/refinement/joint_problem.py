# SPDX-License-Identifier: BSD-3-Clause
"""What all components make of all recordings: errors, and their derivatives by every unknown."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Protocol

import control
import numpy as np
from numpy.typing import NDArray

from piezo_common.arrays import BoolArray, FloatArray
from piezo_identification.conditioning.settling import first_settled
from piezo_identification.conditioning.waveforms import (
    played,
    samples_per_mean,
    with_voltage_before,
)
from piezo_identification.estimators.estimate import (
    dynamics_vector,
    scaled_inverse,
    split_dynamics_vector,
)
from piezo_identification.estimators.frequency_response.sampled_response import respond
from piezo_identification.estimators.refinement.sensitivities import (
    hysteresis_parts,
    sensitivity_systems,
)
from piezo_models.cascade import StageModel
from piezo_models.hysteresis.hysteretic_creep import HystereticCreep
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_models.measures import e_y_percent
from piezo_recorder.reading.recording import Recording

MOST_ROWS = 20_000
"""A longer recording has neighbouring samples averaged, the measured and the simulated ones."""

STRETCHES, HELD_OUT = 50, 5
"""Stretches of a recording, and which of them are held out: one in five."""

LEAST_ROWS = 200
"""A recording with fewer rows is refused."""

CORRELATED = 100
"""Neighbouring rows whose mean tells how far errors are alike."""

SEARCH_WIDTH = np.log(2.0)
"""Factor by which a parameter may leave its start, as a logarithm."""

SAME_OUTPUT = 1e-10
"""Part of the largest singular value of the outputs below which one is the rounding of others."""

SMALL = 1e-6
"""Step of a numerical derivative, over the travel."""


class WeightedErrors(Protocol):
    """What the standard deviations need of a fit."""

    def residual(self, vector: FloatArray) -> FloatArray:
        """Return the weighted errors of all fitted rows."""

    def jacobian(self, vector: FloatArray) -> FloatArray:
        """Return their derivatives by the unknowns."""

    def stretches(self) -> NDArray[np.intp]:
        """Return the first row of every stretch among the fitted rows."""


class RefinementProblem:
    """Vector of unknowns: logarithms of parameters, factors of the density, and weights.

    The weights are those of the hysteretic creep, where the model has it.
    """

    def __init__(self, model: StageModel, recordings: Mapping[str, Recording]) -> None:
        self.first = model
        creep, dynamics = model.creep, model.dynamics
        self.physical = np.concatenate([
            creep.poles_rad_per_s, creep.zeros_rad_per_s, dynamics_vector(dynamics)
        ])
        # Only a lag that is not there is zero.
        self.free = self.physical > 0.0
        self.parts = hysteresis_parts(model.hysteresis)
        logarithms = np.log(self.physical[self.free])
        factors = np.ones(len(self.parts))
        hysteretic = model.hysteretic_creep
        weights = np.array(() if hysteretic is None else hysteretic.weights_um_per_v)
        self.count = logarithms.size
        self.start = np.concatenate([logarithms, factors, weights])
        self.bounds = (
            np.concatenate([logarithms - SEARCH_WIDTH, 0.0 * factors, weights - np.inf]),
            np.concatenate([logarithms + SEARCH_WIDTH, 2.0 * factors, weights + np.inf]),
        )
        self.records = [
            _Record(recording, model, self.parts) for recording in recordings.values()
        ]

    def evaluate(self, vector: FloatArray) -> list["RecordingPart"]:
        """Each recording's `RecordingPart`."""
        creep, dynamics = self.linear(vector)
        return [record.evaluate(creep, dynamics, vector[self.count :]) for record in self.records]

    def linear(
        self, vector: FloatArray,
    ) -> tuple[CreepDynamics, ElectricVibrationDynamics]:
        """Creep and dynamics."""
        physical = np.zeros(self.physical.size)
        physical[self.free] = np.exp(vector[: self.count])
        creep, dynamics = self._named(physical)
        return CreepDynamics(**creep), ElectricVibrationDynamics(**dynamics)

    def model(self, vector: FloatArray) -> StageModel:
        """Return the stage model with the parameters of a vector."""
        creep, dynamics = self.linear(vector)
        factors, weights = np.split(vector[self.count :], [len(self.parts)])
        hysteretic = self.first.hysteretic_creep
        return replace(
            self.first, creep=creep, dynamics=dynamics,
            hysteresis=replace(
                self.first.hysteresis,
                density_um_per_v2=np.tensordot(
                    factors, [part.density_um_per_v2 for part in self.parts], 1),
                reversible_um_per_v=np.tensordot(
                    factors, [part.reversible_um_per_v for part in self.parts], 1),
            ),
            hysteretic_creep=None if hysteretic is None else replace(
                hysteretic, weights_um_per_v=tuple(weights)
            ),
        )

    def standard_deviations(self, fit: WeightedErrors, vector: FloatArray) -> dict[str, Any]:
        """Return those of the physical parameters, with all the others free.

        Errors may be alike within a stretch of a recording, where the density is not quite that of
        the stage; from stretch to stretch they count as independent.
        """
        physical, factors = np.split(fit.jacobian(vector), [self.count], axis=1)
        projected = physical - factors @ np.linalg.lstsq(factors, physical, rcond=1e-10)[0]
        inverse, untold = scaled_inverse(projected)
        # Orthogonal columns: what each row's error pushes, without the square of the condition.
        pushes = (projected @ inverse) * fit.residual(vector)[:, None]
        spread = np.add.reduceat(pushes, fit.stretches()) @ inverse.T
        deviations = np.zeros(self.physical.size)
        deviations[self.free] = np.exp(vector[: self.count]) * np.where(
            untold, np.inf, np.linalg.norm(spread, axis=0))
        creep, dynamics = self._named(deviations)
        return {"creep": creep, "dynamics": dynamics}

    def _named(self, physical: FloatArray) -> tuple[dict[str, Any], dict[str, Any]]:
        """Fields of creep and of dynamics by name."""
        pairs = len(self.first.creep.poles_rad_per_s)
        dynamics = self.first.dynamics
        poles, zeros, rest = np.split(physical, [pairs, 2 * pairs])
        return (
            {"poles_rad_per_s": tuple(poles.tolist()), "zeros_rad_per_s": tuple(zeros.tolist())},
            split_dynamics_vector(
                rest, len(dynamics.mode_frequencies_rad_per_s),
                len(dynamics.antiresonance_frequencies_rad_per_s),
            ),
        )


def _is_fitted(stretch: NDArray[np.intp]) -> BoolArray:
    return stretch % HELD_OUT != HELD_OUT // 2


@dataclass(frozen=True, eq=False)
class RecordingPart:
    """What a vector of unknowns makes of a recording: error, derivatives, and what was fitted.

    Parameters
    ----------
    measured_um, residual_um : ndarray, shape (N,)
    jacobian : ndarray, shape (N, P)
        Of the residual.
    stretch : ndarray of int, shape (N,)
        Stretch of the recording to which each row belongs.
    """

    measured_um: FloatArray
    residual_um: FloatArray
    jacobian: FloatArray
    stretch: NDArray[np.intp]

    @property
    def fitted(self) -> BoolArray:
        """Return the mask of the rows that are fitted, shape (N,)."""
        return _is_fitted(self.stretch)

    @property
    def scale_um(self) -> float:
        """Error of a row, and more where neighbouring rows err alike and count for fewer."""
        error_um = self.residual_um[self.fitted]
        blocks_um = error_um[: error_um.size // CORRELATED * CORRELATED].reshape(-1, CORRELATED)
        alike = CORRELATED * np.mean(blocks_um.mean(axis=1) ** 2)
        return max(np.sqrt(max(alike, np.mean(error_um**2))), np.finfo(float).tiny)

    @property
    def held_out_percent(self) -> float:
        """Return the relative error (4.20) of the rows held out, in percent."""
        held_out = ~self.fitted
        measured_um = self.measured_um[held_out]
        return float(e_y_percent(measured_um, measured_um + self.residual_um[held_out]))


class _Record:
    """A recording, and the outputs that factors and weights multiply."""

    def __init__(
        self, recording: Recording, model: StageModel, parts: list[PreisachModel],
    ) -> None:
        part = played(recording)
        self.stage = model
        self.period_s, self.samples = part.sample_period_s, samples_per_mean(part)
        self.time_s = part.time_s
        self.begin = first_settled(model.dynamics, self.time_s)
        self.averaged = -(-(self.time_s.size - self.begin) // MOST_ROWS)
        rows = (self.time_s.size - self.begin) // max(self.averaged, 1)
        if rows < LEAST_ROWS:
            raise ValueError(f"{recording.path} has {self.time_s.size} samples: record longer")
        self.stretch = np.arange(rows) * STRETCHES // rows
        self.fitted = _is_fitted(self.stretch)
        self.measured_um = self._rows(part.displacement_um)
        joined_v, lead = with_voltage_before(recording, part)
        amplified_v = model.amplified(joined_v, self.period_s)
        before, voltage_v = amplified_v[: lead + 1], amplified_v[lead:]
        past = model.hysteresis.memory()
        model.hysteresis.simulate(before, past)
        operators = _operators(model.hysteretic_creep)
        self.rates_rad_per_s = [
            1.0 / tau for tau in sorted({operator.time_constants_s[0] for operator in operators})
        ]
        outputs_um = np.empty((self.time_s.size, len(parts) + len(operators)))
        for column, operator in zip(outputs_um.T[len(parts) :], operators, strict=True):
            memory = operator.memory(past.extremes_v[: past.top + 1])
            column[:] = operator.simulate(voltage_v, self.period_s, memory)
        for column, hysteresis in zip(outputs_um.T, parts, strict=False):
            memory = hysteresis.memory()
            hysteresis.simulate(before, memory)
            column[:] = hysteresis.simulate(voltage_v, memory)
        # Two levels of voltage make two different outputs, however many surfaces there are.
        _, values, right = np.linalg.svd(np.linalg.qr(outputs_um, mode="r"))
        self.mixture = right[values > SAME_OUTPUT * values[0]]
        self.outputs_um = np.asfortranarray(outputs_um @ self.mixture.T)
        # Two levels show one gain of the hysteresis: free (4.5), it does not bend the density.
        self.free_gain = np.unique(part.voltage_v).size == 2

    def evaluate(
        self, creep: CreepDynamics, dynamics: ElectricVibrationDynamics, factors: FloatArray,
    ) -> "RecordingPart":
        """Error and derivatives with offset and initial creep projected out."""
        linear = replace(self.stage, creep=creep, dynamics=dynamics).linear()
        coefficients = self.mixture @ factors
        by_output = [self._response(linear, column) for column in self.outputs_um.T]
        by_logarithm = [
            self._response(sensitivity * linear, self.outputs_um @ coefficients)
            for sensitivity in sensitivity_systems(creep, dynamics)
        ]
        displacement_um = np.column_stack(by_output) @ coefficients
        displacement_um += self.stage.hysteresis.offset_um * linear.dcgain()
        displacement_um, changes = self._sensed(displacement_um, [*by_logarithm, *by_output])
        by_logarithm, by_output = np.split(changes, [len(by_logarithm)], axis=1)
        by_logarithm, by_factor = list(by_logarithm.T), by_output @ self.mixture
        decays = [np.exp(-pole * self.time_s) for pole in creep.poles_rad_per_s]
        fixed = [np.exp(-rate * self.time_s) for rate in self.rates_rad_per_s]
        beside = np.column_stack(
            [np.ones(self.fitted.size), *(self._rows(decay) for decay in [*decays, *fixed])]
            + [displacement_um] * self.free_gain
        )

        def rest(values: FloatArray) -> tuple[FloatArray, FloatArray]:
            """Of the recording, after what offset and initial creep explain; and how much each."""
            coefficients = np.linalg.lstsq(
                beside[self.fitted], values[self.fitted], rcond=1e-12
            )[0]
            return values - beside @ coefficients, coefficients

        residual_um, initial_um = rest(displacement_um - self.measured_um)
        if self.free_gain:
            by_logarithm = [(1.0 - initial_um[-1]) * column for column in by_logarithm]
        for i, pole in enumerate(creep.poles_rad_per_s):
            by_logarithm[i] += initial_um[1 + i] * self._rows(pole * self.time_s * decays[i])
        jacobian, _ = rest(np.column_stack([*by_logarithm, by_factor]))
        return RecordingPart(self.measured_um, residual_um, jacobian, self.stretch)

    def _response(self, system: control.StateSpace, input_um: FloatArray) -> FloatArray:
        """Displacement, or a derivative of it, of a stage that rested at the first input."""
        return respond(system, input_um, self.period_s, self.samples)

    def _sensed(
        self, displacement_um: FloatArray, changes: list[FloatArray],
    ) -> tuple[FloatArray, FloatArray]:
        """Rows of what the sensor shows, and of its changes, behind the effects that come last."""
        def rows(signal: FloatArray) -> FloatArray:
            return self._rows(self.stage.sensed(signal, self.period_s))

        sensed_um = rows(displacement_um)
        if not (self.stage.effects_at("displacement") or self.stage.effects_at("sensor")):
            return sensed_um, np.column_stack([self._rows(change) for change in changes])
        steps = [SMALL * np.ptp(displacement_um) / max(np.ptp(change), SMALL) for change in changes]
        return sensed_um, np.column_stack([
            (rows(displacement_um + step * change) - sensed_um) / step
            for change, step in zip(changes, steps, strict=True)
        ])

    def _rows(self, signal: FloatArray) -> FloatArray:
        """Means of neighbouring samples, from when the start has settled."""
        settled = signal[self.begin :]
        whole = settled.size // self.averaged * self.averaged
        return settled[:whole].reshape(-1, self.averaged).mean(axis=1)


def _operators(hysteretic_creep: HystereticCreep | None) -> list[HystereticCreep]:
    """Each operator alone, with unit weight."""
    if hysteretic_creep is None:
        return []
    return [
        HystereticCreep((width,), (time_constant_s,), (1.0,))
        for width, time_constant_s in zip(
            hysteretic_creep.half_widths_v, hysteretic_creep.time_constants_s, strict=True
        )
    ]
