# SPDX-License-Identifier: BSD-3-Clause
"""All components fitted together on all recordings, from a model identified step by step."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from piezo_common.arrays import FloatArray
from piezo_identification.conditioning.waveforms import played
from piezo_identification.estimators.refinement.joint_problem import (
    STRETCHES,
    RecordingPart,
    RefinementProblem,
)
from piezo_models.cascade import StageModel
from piezo_models.hysteresis.hysteretic_creep import HystereticCreep
from piezo_recorder.reading.recording import Recording

HALF_WIDTHS = (0.0, 0.15, 0.3)
"""Play operators of these half widths, over the voltage range, are tried for hysteretic creep."""

TIME_CONSTANTS_S = (1.0, 10.0, 100.0)
"""These operators creep so fast; a recording must last twice as long for one to be tried."""

WORTHWHILE = 0.9
"""Part below which a fit has to bring the mean square error held out. Less would be bought with the
errors of inputs that are not in the recordings."""

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

    model: StageModel
    improved: bool
    held_out_ratio: float
    before_percent: dict[str, float]
    after_percent: dict[str, float]
    standard_deviations: dict[str, Any]


def refine(
    model: StageModel, recordings: Mapping[str, Recording],
    progress: Callable[[float], object] | None = None,
) -> Refinement:
    """Fit creep, electric and vibration dynamics and hysteresis together on all recordings.

    The error of the simulated displacement is made least. Every physical parameter of the linear
    dynamics is free, and so is a surface by which the density is multiplied; it starts at one. Each
    recording has an offset and an initial state of the creep of its own, which are projected out,
    and one between two levels of voltage has a gain of the hysteresis of its own (4.5).
    Derivatives are outputs of sensitivity systems, and exact. Each recording is
    scaled by its error, and its rows count for as many as are independent.

    Effects of the model take part as they are.

    Then hysteretic creep is tried beside: play operators of a few widths and time constants, whose
    weights are fitted with everything else. It is left out unless the error held out falls
    significantly.

    One stretch in five of every recording is held out, and decides: unless the fit brings the mean
    square error there below `WORTHWHILE` of what it was, the starting model is returned. The
    starting model may have seen those stretches, the fit has not.

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
    best = plain if plain.ratio < WORTHWHILE else None
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

    model: StageModel
    before: list[RecordingPart]
    after: list[RecordingPart]
    standard_deviations: dict[str, Any]

    @property
    def ratio(self) -> float:
        return _held_out_ratio(self.before, self.after)


def _attempt(
    model: StageModel, recordings: Mapping[str, Recording], begun: float,
    progress: Callable[[float], object] | None,
) -> _Attempt:
    """Fit from a model; `begun` of the whole work is done before."""
    problem = RefinementProblem(model, recordings)
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
    return _Attempt(problem.model(vector), before, after, problem.standard_deviations(fit, vector))


def _held_out_ratio(before: list[RecordingPart], after: list[RecordingPart]) -> float:
    """Mean over the recordings of the ratios of the mean square errors held out."""
    return float(np.mean([
        np.mean(new.residual_um[~new.fitted] ** 2) / np.mean(old.residual_um[~old.fitted] ** 2)
        for new, old in zip(after, before, strict=True)
    ]))


def _with_hysteretic_creep(
    model: StageModel, recordings: Mapping[str, Recording],
) -> StageModel | None:
    """Add operators of weight zero to the model; None where no recording would show them."""
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

    def __init__(
        self, problem: RefinementProblem, vector: FloatArray, parts: list[RecordingPart],
    ) -> None:
        self.problem, self.vector, self.parts = problem, vector, parts
        self.scales = [part.scale_um for part in parts]
        self.report: Callable[[float], object] | None = None
        self.steps = 0

    def parts_at(self, vector: FloatArray) -> list[RecordingPart]:
        """Return each recording's `RecordingPart`."""
        if not np.array_equal(vector, self.vector):
            self.vector, self.parts = vector.copy(), self.problem.evaluate(vector)
        return self.parts

    def residual(self, vector: FloatArray) -> FloatArray:
        """Return the residual of all fitted rows."""
        if self.report is not None:
            self.report(min(1.0, self.steps / MOST_EVALUATIONS))
        self.steps += 1
        return self._stacked([part.residual_um[part.fitted] for part in self.parts_at(vector)])

    def stretches(self) -> NDArray[np.intp]:
        """First row of every stretch among the fitted rows."""
        numbers = np.concatenate([
            part.stretch[part.fitted] + STRETCHES * number
            for number, part in enumerate(self.parts)
        ])
        return np.flatnonzero(np.diff(numbers, prepend=-1))

    def jacobian(self, vector: FloatArray) -> FloatArray:
        """Return the derivatives of all fitted rows by the unknowns."""
        return self._stacked([part.jacobian[part.fitted] for part in self.parts_at(vector)])

    def _stacked(self, values: list[FloatArray]) -> FloatArray:
        return np.concatenate(
            [value / scale for value, scale in zip(values, self.scales, strict=True)]
        )
