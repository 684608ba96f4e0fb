# SPDX-License-Identifier: BSD-3-Clause
"""Measures by which fits of a frequency response are compared on the validation set."""

from dataclasses import dataclass

import numpy as np

from piezo_common.arrays import BoolArray, ComplexArray, FloatArray
from piezo_identification.diagnosis.response.response_effect_fit import (
    SETTINGS,
    ResponseFit,
    ResponseProblem,
)
from piezo_identification.fitting.regression import SETTINGS as FIT


@dataclass(frozen=True)
class ResponseCriteria:
    """When a further effect is named."""

    significant: float = 3.0
    """Significance required of a gain on held-out blocks, in standard deviations."""
    worthwhile_percent: float = 10.0
    """Smallest reduction of the error on held-out frequencies for which an effect is named."""
    distinguished_percent: float = 5.0
    """Smallest difference of two errors that distinguishes candidates."""
    explained: float = 1.0
    """Largest mean square beyond the tolerance of an explained response."""
    near_noise: float = 3.0
    """Largest residual of an explained response, relative to the noise."""
    most_effects: int = 4
    """Number of kinds of linear effects."""


CRITERIA = ResponseCriteria()


def mean_square(problem: ResponseProblem, fit: ResponseFit,
                part: BoolArray | None = None) -> float:
    """Return the mean square residual in tolerances, by default on the validation set."""
    return float(np.mean(np.abs(fit.residual[~problem.estimation if part is None else part]) ** 2))


def lack_of_fit(problem: ResponseProblem, fit: ResponseFit) -> float:
    """Return the mean square residual beyond the tolerance."""
    return max(0.0, mean_square(problem, fit) - 2.0)


def reduction_percent(problem: ResponseProblem, before: ResponseFit, after: ResponseFit) -> float:
    """Return the reduction of the error on held-out frequencies in percent."""
    squares = [mean_square(problem, fit) for fit in (after, before)]
    return float(100.0 * (1.0 - np.sqrt(squares[0] / squares[1])))


def is_convincing(problem: ResponseProblem, before: ResponseFit, after: ResponseFit) -> bool:
    """Return whether the second fit is better, consistently over the held-out blocks."""
    if reduction_percent(problem, before, after) < CRITERIA.worthwhile_percent:
        return False
    rows, change = ~problem.estimation, before.residual - after.residual

    def blocks(residual: ComplexArray) -> FloatArray:
        sums = np.bincount(problem.block[rows], (residual * change.conj()).real[rows])
        return np.asarray(sums, dtype=float)

    spread = np.sqrt(np.sum(blocks(after.residual) ** 2))
    return bool(np.sum(blocks(before.residual)) > CRITERIA.significant * spread)


def held_out_errors(problem: ResponseProblem, fit: ResponseFit) -> dict[str, float]:
    """Return the errors of the gain on held-out frequencies: `rms_um` and `e_y_percent`."""
    rows = ~problem.estimation
    error = np.linalg.norm((fit.residual * problem.tolerance)[rows])
    return {
        "rms_um": float(error / np.sqrt(np.count_nonzero(rows))),
        "e_y_percent": float(100.0 * error / np.linalg.norm(problem.measured.gain[rows])),
    }


def describe_residual(problem: ResponseProblem, fit: ResponseFit) -> str:
    """Return a sentence on the residual and its frequencies."""
    energy = np.abs(fit.residual) ** 2
    power = np.cumsum(energy) / np.sum(energy)
    frequency_hz = problem.measured.frequency_hz
    low_hz, high_hz = frequency_hz[np.searchsorted(power, [0.1, 0.9])]
    worst = int(np.argmax(energy))
    return (
        f"What remains is {held_out_errors(problem, fit)['rms_um'] / problem.noise:.3g} times the "
        "noise that neighbouring frequencies show. "
        f"The residual is {np.sqrt(np.mean(energy)):.3g} times the tolerance of "
        f"{100 * SETTINGS.tolerance:g} % and the noise, most of it from {low_hz:.3g} to "
        f"{high_hz:.3g} Hz, largest at {frequency_hz[worst]:.4g} Hz."
    )


def is_explained(problem: ResponseProblem, fit: ResponseFit) -> bool:
    """Return whether the residual on held-out frequencies is small enough to be noise.

    For a response without noise, the accuracy of a good model is the limit.
    """
    gain = np.sqrt(np.mean(np.abs(problem.measured.gain[~problem.estimation]) ** 2))
    passing = CRITERIA.near_noise * np.hypot(problem.noise, FIT.model_tolerance * gain)
    return bool(lack_of_fit(problem, fit) <= CRITERIA.explained
                and held_out_errors(problem, fit)["rms_um"] <= passing)
