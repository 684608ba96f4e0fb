# SPDX-License-Identifier: BSD-3-Clause
"""Electric lag, vibration modes and antiresonances of least output error."""

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.optimize import least_squares

from piezo_common.cancellation import check_cancelled
from piezo_identification.estimators.estimate import (
    Estimate,
    dynamics_of_vector,
    dynamics_vector,
    order_trial,
    parameter_covariance,
    split_dynamics_vector,
)
from piezo_models.linear.dynamics import ElectricVibrationDynamics

MOST_MODES = 4
"""Vibration modes beyond which the search for their number ends."""

PATIENCE = 2
"""Numbers of modes in succession that may bring no gain before the search ends."""

MODES_LEFT_OUT = 2
"""Dynamics richer by up to so many modes are fitted, and the modes taken that explain most: those
that ring longest are not those that move a stage most."""

SEARCH_WIDTH = np.log(3.0)
"""Factor by which the fit may leave its start, as a logarithm."""

ANTIRESONANCE_SPAN = 3.0
"""Factor beyond the modes within which an antiresonance is taken for one."""

COLLINEAR = 1e-9
"""Singular value, of the largest one, below which columns that are fitted linearly count as one:
far above rounding, far below what the noise of any record leaves of them."""


@dataclass(frozen=True)
class ModeOrder:
    """Numbers of components.

    Parameters
    ----------
    modes, antiresonances : int
    """

    modes: int
    antiresonances: int = 0

    def __str__(self):
        return f"{self.modes}-{self.antiresonances}" if self.antiresonances else f"{self.modes}"


def fit_output_error(respond, measured_um, fixed, start, mode_count=None):
    """Electric and vibration dynamics (4.3) of least output error.

    Modes that move side by side leave antiresonances between them, which a product of modes (4.3)
    lacks: every number of modes is also tried with those that the response to its poles shows.

    Parameters
    ----------
    respond : callable
        Response (N,) of dynamics to the input of the record.
    measured_um : ndarray, shape (N,)
        Creep removed.
    fixed : ndarray, shape (N, K)
        What else the output may hold, such as an offset; fitted linearly, as is the gain.
    start : callable
        Dynamics of a number of modes from which to begin.
    mode_count : int, optional
        Number of modes, without antiresonances; by default as many of both as the Bayesian
        information criterion justifies.

    Returns
    -------
    Estimate
        Its order is a `ModeOrder`.
    """
    record = _Record(respond, measured_um, fixed)
    if mode_count is not None:
        fit = min((record.fit(begin) for begin in record.starts(start, mode_count)),
                  key=lambda fit: fit.trial.information)
        return fit.estimate((fit.trial,), True)
    best, trials, without_gain = None, [], 0
    for count in range(MOST_MODES + 1):
        begin = start(count)
        fits = [record.fit(begin)]
        zeros = record.antiresonances(begin)
        if zeros.antiresonance_damping_ratios:
            fits.append(record.fit(zeros))
        trials += [fit.trial for fit in fits]
        better = min(fits, key=lambda fit: fit.trial.information)
        if best is None or better.trial.information < best.trial.information:
            best, without_gain = better, 0
        else:
            without_gain += 1
        if without_gain == PATIENCE:
            break
    return best.estimate(tuple(trials), False)


@dataclass(frozen=True, eq=False)
class _Fit:
    model: ElectricVibrationDynamics
    standard_deviations: dict
    trial: object

    def estimate(self, trials, order_given):
        return Estimate(
            self.model, self.standard_deviations, self.trial.order, trials, order_given
        )


class _Record:
    """An output, and the response of models to its input."""

    def __init__(self, respond, measured_um, fixed):
        self._respond, self._measured_um = respond, measured_um
        self._fixed = independent(fixed)

    def fit(self, start):
        """Fit the dynamics of least output error near others, with as many modes and zeros."""
        counts = len(start.damping_ratios), len(start.antiresonance_damping_ratios)
        logarithms = np.log(dynamics_vector(start))
        solution = least_squares(
            lambda logarithms: self._left([self._respond(
                dynamics_of_vector(np.exp(logarithms), *counts))])[0],
            logarithms, xtol=1e-10, ftol=1e-12, max_nfev=40,
            bounds=(logarithms - SEARCH_WIDTH, logarithms + SEARCH_WIDTH),
        )
        parameters = solution.x.size + 1 + self._fixed.shape[1]
        covariance = parameter_covariance(solution.jac, solution.fun, parameters)
        vector = np.exp(solution.x)
        return _Fit(
            dynamics_of_vector(vector, *counts),
            split_dynamics_vector(vector * np.sqrt(np.diag(covariance)), *counts),
            order_trial(ModeOrder(*counts), solution.fun, parameters),
        )

    def starts(self, start, count):
        """Yield the start with so many modes, and the best choice from those with more."""
        yield start(count)
        choices = []
        for left_out in range(1, MODES_LEFT_OUT + 1):
            try:
                richer = start(count + left_out)
            except ValueError:
                # The record is too short for as many.
                break
            modes = zip(richer.mode_frequencies_rad_per_s, richer.damping_ratios, strict=True)
            for chosen in combinations(modes, count):
                frequencies, dampings = zip(*chosen, strict=True) if chosen else ((), ())
                choices.append(ElectricVibrationDynamics(
                    richer.time_constant_s, frequencies, dampings))
        if choices:
            yield min(choices, key=lambda model: np.sum(
                self._left([self._respond(model)])[0] ** 2))

    def antiresonances(self, model):
        """Add to the poles of a model the antiresonances of modes that respond side by side.

        The lag and every mode answer the input side by side, with gains that fit best: the zeros
        of their sum are those of the stage.
        """
        modes = list(zip(model.mode_frequencies_rad_per_s, model.damping_ratios, strict=True))
        if not modes:
            return model
        parts, numerators = [], []
        for frequency, damping in modes:
            mode = ElectricVibrationDynamics(model.time_constant_s, (frequency,), (damping,))
            parts.append(self._respond(mode))
            numerators.append([
                [1.0] if other == (frequency, damping)
                else [other[0] ** -2, 2.0 * other[1] / other[0], 1.0] for other in modes
            ])
        gains = self._left(parts)[1][: len(parts)]
        numerator = np.zeros(1)
        for gain, factors in zip(gains, numerators, strict=True):
            product = np.array([gain])
            for factor in factors:
                product = np.polymul(product, factor)
            numerator = np.polyadd(numerator, product)
        zeros = np.roots(numerator)
        frequencies = np.abs(zeros)
        low, high = min(modes)[0], max(modes)[0]
        zeros = zeros[(zeros.imag > 0.0) & (frequencies > low / ANTIRESONANCE_SPAN)
                      & (frequencies < high * ANTIRESONANCE_SPAN)]
        # Zeros on the right are no antiresonances of stable damping: start from the axis.
        dampings = np.maximum(-zeros.real / np.abs(zeros), 1e-3)
        return replace(
            model, antiresonance_frequencies_rad_per_s=tuple(np.abs(zeros).tolist()),
            antiresonance_damping_ratios=tuple(dampings.tolist()),
        )

    def _left(self, parts):
        """Fit parts and fixed columns to the measured output; return the residual and the gains."""
        check_cancelled()
        basis = np.column_stack([*parts, self._fixed])
        gains = np.linalg.lstsq(basis, self._measured_um, rcond=COLLINEAR)[0]
        return self._measured_um - basis @ gains, gains


def independent(columns):
    """Return orthonormal columns of the same span, without what only rounding tells apart.

    Slow exponentials look alike in a short record. Were they kept as they are, the least error
    would be as rough as the rounding of the processor, and a search would end anywhere on it.

    Parameters
    ----------
    columns : ndarray, shape (N, K)

    Returns
    -------
    ndarray, shape (N, L)
        With L up to K.
    """
    left, values, _ = np.linalg.svd(
        columns / np.linalg.norm(columns, axis=0), full_matrices=False)
    return left[:, values > COLLINEAR * values[0]]
