# SPDX-License-Identifier: BSD-3-Clause
"""All components fitted together on all recordings, from a model identified step by step."""

from dataclasses import dataclass, replace

import control
import numpy as np
from scipy.optimize import least_squares

from piezo_identification.estimate import (
    dynamics_vector,
    parameter_covariance,
    split_dynamics_vector,
)
from piezo_identification.prediction import mean_zoh
from piezo_identification.settling import settling_time_s
from piezo_identification.waveforms import played, samples_per_mean
from piezo_models.hysteretic_creep import HystereticCreep
from piezo_models.linear import (
    CreepDynamics,
    ElectricVibrationDynamics,
    equilibrium_state,
    simulate_linear,
)
from piezo_models.measures import e_y_percent

MIDDLE_KNOTS, SPAN_KNOTS = 4, 8
"""Between which the surface that multiplies the density is bilinear."""

MOST_ROWS = 20_000
"""Of a recording; neighbouring samples of longer ones are averaged, measured and simulated."""

STRETCHES, HELD_OUT = 200, 5
"""Stretches of a recording, and which of them are held out: one in five."""

CORRELATED = 100
"""Neighbouring rows whose mean tells how far errors are alike."""

SEARCH_WIDTH = np.log(2.0)
"""Factor by which a parameter may leave its start, as a logarithm."""

HALF_WIDTHS = (0.0, 0.15, 0.3)
"""Of the play operators that are tried for hysteretic creep, over the voltage range."""

TIME_CONSTANTS_S = (1.0, 10.0, 100.0)
"""Of these operators, as far as a recording lasts twice as long."""

SIGNIFICANT = 0.8
"""Hysteretic creep is kept if it brings the mean square error held out below this part."""

ROUNDS = 2
"""Fits; the weights of the recordings in a fit follow from the errors before it."""

MOST_EVALUATIONS = 8
"""Steps of a fit; it starts near its end."""


@dataclass(frozen=True, eq=False)
class Refinement:
    """A refined model, or the starting model where refining did not help, and the evidence.

    Parameters
    ----------
    model : StageModel
    improved : bool
        False if `model` is the starting model.
    held_out_ratio : float
        Mean square error on the stretches held out, over that of the starting model, averaged over
        the recordings. Below 1 where the fit improved it, whether or not that was accepted.
    before_percent, after_percent : dict of str to float
        Relative error e_y (4.20) on these stretches, in percent, of the starting model and of the
        fitted one, by recording.
    standard_deviations : dict
        Of creep and dynamics, in names and shapes those of the model; empty if not improved.
    """

    model: object
    improved: bool
    held_out_ratio: float
    before_percent: dict
    after_percent: dict
    standard_deviations: dict


def refine(model, recordings, progress=None):
    """Fit creep, electric and vibration dynamics and hysteresis together on all recordings.

    The error of the simulated displacement is made least. Every physical parameter of the linear
    dynamics is free, and so is a surface by which the density is multiplied; it starts at one. Each
    recording has an offset and an initial state of the creep of its own, which are projected out.
    Derivatives are outputs of sensitivity systems, and exact. Each recording is
    scaled by its error, and its rows count for as many as are independent.

    Then hysteretic creep is tried beside: play operators of a few widths and time constants, whose
    weights are fitted with everything else. It is left out unless the error held out falls
    significantly.

    One stretch in five of every recording is held out, and decides: where the fit does not improve
    the error there, the starting model is returned. The starting model may have seen those
    stretches, the fit has not.

    Parameters
    ----------
    model : StageModel
    recordings : dict of str to Recording
        By name.
    progress : callable, optional
        Called with the fraction done at every step; an exception of it ends the work.

    Returns
    -------
    Refinement

    Raises
    ------
    ValueError
        If there is no recording, or one has gaps or is too short.
    """
    if not recordings:
        raise ValueError("there is no recording to refine the model on: give one")
    plain = _attempt(model, recordings, 0.0, progress)
    best = plain if plain.ratio < 1.0 else None
    start = model if best is None else best.model
    candidate = _with_hysteretic_creep(start, recordings)
    if candidate is not None:
        crept = _attempt(candidate, recordings, 0.5, progress)
        if crept.ratio < SIGNIFICANT:
            best = crept
    fitted = plain if best is None else best
    names_and_parts = list(zip(recordings, plain.before, fitted.after, strict=True))
    return Refinement(
        model if best is None else best.model, best is not None,
        _held_out_ratio(plain.before, fitted.after),
        {name: part.held_out_percent for name, part, _ in names_and_parts},
        {name: part.held_out_percent for name, _, part in names_and_parts},
        {} if best is None else best.standard_deviations,
    )


@dataclass(frozen=True, eq=False)
class _Attempt:
    """A fit, and what each recording was before and after it."""

    model: object
    before: list
    after: list
    standard_deviations: dict

    @property
    def ratio(self):
        return _held_out_ratio(self.before, self.after)


def _attempt(model, recordings, begun, progress):
    """Fit from a model; `begun` of the whole work is done before."""
    problem = _Problem(model, recordings)
    vector = problem.start
    before = after = problem.evaluate(vector)
    for turn in range(ROUNDS):
        fit = _Fit(problem, vector, after)
        if progress is not None:
            fit.report = lambda part, turn=turn: progress(begun + 0.5 * (turn + part) / ROUNDS)
        solution = least_squares(
            fit.residual, vector, fit.jacobian, bounds=problem.bounds, x_scale="jac", ftol=1e-4,
            max_nfev=MOST_EVALUATIONS,
        )
        vector, after = solution.x, fit.parts_at(solution.x)
    return _Attempt(problem.model(vector), before, after, problem.standard_deviations(solution))


def _held_out_ratio(before, after):
    """Mean over the recordings of the ratios of the mean square errors held out."""
    return float(np.mean([
        np.mean(new.residual_um[~new.fitted] ** 2) / np.mean(old.residual_um[~old.fitted] ** 2)
        for new, old in zip(after, before, strict=True)
    ]))


def _with_hysteretic_creep(model, recordings):
    """The model with operators of weight zero, or None where no recording would show them."""
    longest_s = max(played(recording).time_s[-1] for recording in recordings.values())
    travel_v = model.hysteresis.voltage_max_v - model.hysteresis.voltage_min_v
    operators = [
        (width * travel_v, time_constant_s, 0.0)
        for time_constant_s in TIME_CONSTANTS_S if 2.0 * time_constant_s <= longest_s
        for width in HALF_WIDTHS
    ]
    if not operators or model.hysteretic_creep is not None:
        return None
    return replace(model, hysteretic_creep=HystereticCreep(*zip(*operators, strict=True)))


class _Fit:
    """Weighted errors and derivatives of all recordings in the form that the optimiser takes."""

    def __init__(self, problem, vector, parts):
        self.problem, self.vector, self.parts = problem, vector, parts
        self.scales = [part.scale_um for part in parts]
        self.report, self.steps = None, 0

    def parts_at(self, vector):
        """Each recording's `_Part`."""
        if not np.array_equal(vector, self.vector):
            self.vector, self.parts = vector.copy(), self.problem.evaluate(vector)
        return self.parts

    def residual(self, vector):
        """Of all fitted rows."""
        if self.report is not None:
            self.report(min(1.0, self.steps / MOST_EVALUATIONS))
        self.steps += 1
        return self._stacked([part.residual_um[part.fitted] for part in self.parts_at(vector)])

    def jacobian(self, vector):
        """Of all fitted rows by the unknowns."""
        return self._stacked([part.jacobian[part.fitted] for part in self.parts_at(vector)])

    def _stacked(self, values):
        return np.concatenate(
            [value / scale for value, scale in zip(values, self.scales, strict=True)]
        )


class _Problem:
    """Vector of unknowns: logarithms of parameters, factors of the density, and weights.

    The weights are those of the hysteretic creep, where the model has it.
    """

    def __init__(self, model, recordings):
        self.first = model
        creep, dynamics = model.creep, model.dynamics
        self.physical = np.concatenate([
            creep.poles_rad_per_s, creep.zeros_rad_per_s, dynamics_vector(dynamics)
        ])
        # Only a lag that is not there is zero.
        self.free = self.physical > 0.0
        self.surfaces = factor_surfaces(model.hysteresis.density_um_per_v2.shape[0])
        logarithms = np.log(self.physical[self.free])
        factors = np.ones(len(self.surfaces))
        hysteretic = model.hysteretic_creep
        weights = np.array(() if hysteretic is None else hysteretic.weights_um_per_v)
        self.count = logarithms.size
        self.start = np.concatenate([logarithms, factors, weights])
        self.bounds = (
            np.concatenate([logarithms - SEARCH_WIDTH, 0.0 * factors, weights - np.inf]),
            np.concatenate([logarithms + SEARCH_WIDTH, 2.0 * factors, weights + np.inf]),
        )
        self.records = [
            _Record(recording, model, self.surfaces) for recording in recordings.values()
        ]

    def evaluate(self, vector):
        """Each recording's `_Part`."""
        creep, dynamics = self.linear(vector)
        return [record.evaluate(creep, dynamics, vector[self.count :]) for record in self.records]

    def linear(self, vector):
        """Creep and dynamics."""
        physical = np.zeros(self.physical.size)
        physical[self.free] = np.exp(vector[: self.count])
        creep, dynamics = self._named(physical)
        return CreepDynamics(**creep), ElectricVibrationDynamics(**dynamics)

    def model(self, vector):
        """The stage model."""
        creep, dynamics = self.linear(vector)
        hysteresis = self.first.hysteresis
        factors, weights = np.split(vector[self.count :], [len(self.surfaces)])
        surface = np.tensordot(factors, self.surfaces, 1)
        hysteretic = self.first.hysteretic_creep
        return replace(
            self.first, creep=creep, dynamics=dynamics,
            hysteresis=replace(
                hysteresis, density_um_per_v2=hysteresis.density_um_per_v2 * surface
            ),
            hysteretic_creep=None if hysteretic is None else replace(
                hysteretic, weights_um_per_v=tuple(weights)
            ),
        )

    def standard_deviations(self, solution):
        """Of the physical parameters, with all the others free."""
        physical, factors = np.split(solution.jac, [self.count], axis=1)
        projected = physical - factors @ np.linalg.lstsq(factors, physical, rcond=1e-10)[0]
        covariance = parameter_covariance(projected, solution.fun, solution.x.size)
        deviations = np.zeros(self.physical.size)
        deviations[self.free] = np.exp(solution.x[: self.count]) * np.sqrt(np.diag(covariance))
        creep, dynamics = self._named(deviations)
        return {"creep": creep, "dynamics": dynamics}

    def _named(self, physical):
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


@dataclass(frozen=True, eq=False)
class _Part:
    """What a vector of unknowns makes of a recording: error, derivatives, and what was fitted."""

    measured_um: np.ndarray
    residual_um: np.ndarray
    jacobian: np.ndarray
    fitted: np.ndarray

    @property
    def scale_um(self):
        """Error of a row, and more where neighbouring rows err alike and count for fewer."""
        error_um = self.residual_um[self.fitted]
        blocks_um = error_um[: error_um.size // CORRELATED * CORRELATED].reshape(-1, CORRELATED)
        alike = CORRELATED * np.mean(blocks_um.mean(axis=1) ** 2)
        return max(np.sqrt(max(alike, np.mean(error_um**2))), np.finfo(float).tiny)

    @property
    def held_out_percent(self):
        held_out = ~self.fitted
        measured_um = self.measured_um[held_out]
        return float(e_y_percent(measured_um, measured_um + self.residual_um[held_out]))


class _Record:
    """A recording, and the outputs that factors and weights multiply."""

    def __init__(self, recording, model, surfaces):
        part = played(recording)
        self.period_s, self.samples = part.sample_period_s, samples_per_mean(part)
        self.time_s = part.time_s
        self.begin = int(np.searchsorted(self.time_s, settling_time_s(model.dynamics)))
        self.averaged = -(-(self.time_s.size - self.begin) // MOST_ROWS)
        rows = (self.time_s.size - self.begin) // max(self.averaged, 1)
        if rows < STRETCHES:
            raise ValueError(f"{recording.path} has {self.time_s.size} samples: record longer")
        self.fitted = np.arange(rows) * STRETCHES // rows % HELD_OUT != HELD_OUT // 2
        self.measured_um = self._rows(part.displacement_um)
        before = recording.select(recording.sample_index <= part.sample_index[0]).voltage_v
        density = model.hysteresis.density_um_per_v2
        past = model.hysteresis.memory()
        model.hysteresis.simulate(before, past)
        operators = _operators(model.hysteretic_creep)
        self.rates_rad_per_s = [
            1.0 / tau for tau in sorted({operator.time_constants_s[0] for operator in operators})
        ]
        outputs_um = np.empty((self.time_s.size, len(surfaces) + len(operators)))
        for column, operator in zip(outputs_um.T[len(surfaces) :], operators, strict=True):
            memory = operator.memory(past.extremes_v[: past.top + 1])
            column[:] = operator.simulate(part.voltage_v, self.period_s, memory)
        for column, surface in zip(outputs_um.T, surfaces, strict=False):
            hysteresis = replace(
                model.hysteresis, density_um_per_v2=density * surface, offset_um=0.0
            )
            memory = hysteresis.memory()
            hysteresis.simulate(before, memory)
            column[:] = hysteresis.simulate(part.voltage_v, memory)
        # Two levels of voltage make two different outputs, however many surfaces there are.
        values, vectors = np.linalg.eigh(outputs_um.T @ outputs_um)
        self.mixture = vectors[:, values > 1e-14 * values[-1]].T
        self.outputs_um = np.asfortranarray(outputs_um @ self.mixture.T)

    def evaluate(self, creep, dynamics, factors):
        """Error and derivatives with offset and initial creep projected out."""
        linear = creep.state_space() * dynamics.state_space()
        hysteresis_um = self.outputs_um @ (self.mixture @ factors)
        by_factor = np.column_stack(
            [self._response(linear, column) for column in self.outputs_um.T]
        ) @ self.mixture
        by_logarithm = [
            self._response(sensitivity * linear, hysteresis_um)
            for sensitivity in sensitivity_systems(creep, dynamics)
        ]
        decays = [np.exp(-pole * self.time_s) for pole in creep.poles_rad_per_s]
        fixed = [np.exp(-rate * self.time_s) for rate in self.rates_rad_per_s]
        beside = np.column_stack(
            [np.ones(self.fitted.size), *(self._rows(decay) for decay in [*decays, *fixed])]
        )

        def rest(values):
            """Of the recording, after what offset and initial creep explain; and how much each."""
            coefficients = np.linalg.lstsq(
                beside[self.fitted], values[self.fitted], rcond=1e-12
            )[0]
            return values - beside @ coefficients, coefficients

        residual_um, initial_um = rest(by_factor @ factors - self.measured_um)
        for i, pole in enumerate(creep.poles_rad_per_s):
            by_logarithm[i] += initial_um[1 + i] * self._rows(pole * self.time_s * decays[i])
        jacobian, _ = rest(np.column_stack([*by_logarithm, by_factor]))
        return _Part(self.measured_um, residual_um, jacobian, self.fitted)

    def _response(self, system, input_um):
        """Displacement, or a derivative of it, of a stage that rested at the first input."""
        output_um = simulate_linear(
            mean_zoh(system, self.period_s, self.samples), input_um,
            equilibrium_state(system, input_um[0]),
        )
        return self._rows(output_um)

    def _rows(self, signal):
        """Means of neighbouring samples, from when the start has settled."""
        settled = signal[self.begin :]
        whole = settled.size // self.averaged * self.averaged
        return settled[:whole].reshape(-1, self.averaged).mean(axis=1)


def _operators(hysteretic_creep):
    """Each operator alone, with unit weight."""
    if hysteretic_creep is None:
        return []
    return [
        HystereticCreep((width,), (time_constant_s,), (1.0,))
        for width, time_constant_s in zip(
            hysteretic_creep.half_widths_v, hysteretic_creep.time_constants_s, strict=True
        )
    ]


def sensitivity_systems(creep, dynamics):
    """Systems that turn the displacement into its derivatives by the logarithms of parameters.

    The derivative of a factor of the transfer function by one of its parameters, over the factor.

    Parameters
    ----------
    creep : CreepDynamics
    dynamics : ElectricVibrationDynamics

    Returns
    -------
    list of control.StateSpace
        Creep poles, creep zeros, time constant unless it is 0, mode frequencies, damping ratios,
        and those of the antiresonances.
    """
    def first_order(rate, gain, direct=0.0):
        return control.ss([[-rate]], [[rate]], [[gain]], [[direct]])

    def second_order(frequency, damping, position, velocity, direct):
        return control.ss(
            [[0.0, frequency], [-frequency, -2.0 * damping * frequency]], [[0.0], [frequency]],
            [[position, velocity]], [[direct]],
        )

    systems = [first_order(pole, -1.0) for pole in creep.poles_rad_per_s]
    systems += [first_order(zero, 1.0) for zero in creep.zeros_rad_per_s]
    if dynamics.time_constant_s > 0.0:
        systems.append(first_order(1.0 / dynamics.time_constant_s, 1.0, -1.0))
    for frequencies, dampings, sign in (
        (dynamics.mode_frequencies_rad_per_s, dynamics.damping_ratios, 1.0),
        (dynamics.antiresonance_frequencies_rad_per_s, dynamics.antiresonance_damping_ratios, -1.0),
    ):
        pairs = list(zip(frequencies, dampings, strict=True))
        systems += [
            second_order(w, d, -2.0 * sign, -2.0 * sign * d, 2.0 * sign) for w, d in pairs
        ]
        systems += [second_order(w, d, 0.0, -2.0 * sign * d, 0.0) for w, d in pairs]
    return systems


def factor_surfaces(size, middle_knots=MIDDLE_KNOTS, span_knots=SPAN_KNOTS):
    """Surfaces over the cells of a density that sum to one.

    They are bilinear between knots in the middle of the thresholds and in the root of their span:
    a density changes fastest near the diagonal, where the knots lie close.

    Parameters
    ----------
    size : int
        Cells along each threshold.
    middle_knots, span_knots : int

    Returns
    -------
    ndarray, shape (surfaces, size, size)
        Lower triangular.
    """
    alpha, beta = np.indices((size, size))
    # A cell on the diagonal is a triangle, whose centroid lies aside.
    span = np.where(alpha == beta, 1.0 / 3.0, alpha - beta) / size

    def hats(position, knots):
        return [
            np.maximum(0.0, 1.0 - np.abs(position * (knots - 1) - knot)) for knot in range(knots)
        ]

    surfaces = [
        np.tril(middle_hat * span_hat)
        for middle_hat in hats(0.5 * (alpha + beta + 1) / size, middle_knots)
        for span_hat in hats(np.sqrt(np.maximum(span, 0.0)), span_knots)
    ]
    return np.array([surface for surface in surfaces if surface.any()])
