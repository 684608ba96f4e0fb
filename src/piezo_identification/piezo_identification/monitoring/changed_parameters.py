# SPDX-License-Identifier: BSD-3-Clause
"""Find the model parameters that have changed since the model fitted the stage.

It is assumed that the structure of the model is still valid. Groups of parameters that change
together are fitted by nonlinear least squares, and compared on stretches of the recording that were
excluded from the fit.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from piezo_common.arrays import BoolArray, FloatArray
from piezo_identification.conditioning.outlier_samples import with_outliers_marked
from piezo_identification.simulation.past_search import simulated_recording
from piezo_models.cascade import StageModel
from piezo_models.linear.dynamics_vector import dynamics_of_vector, dynamics_vector
from piezo_recorder.reading.recording import Recording


@dataclass(frozen=True)
class ChangeSettings:
    """Settings of the search for changed parameters."""

    stretches: int = 30
    """Number of stretches of the recording; every third is held out."""
    most_groups: int = 2
    """Most groups of parameters that may have changed at once."""
    significant: float = 5.0
    """Smallest mean improvement on the held-out stretches for which a group is accepted, in
    standard deviations."""
    largest_logarithm: float = 0.5
    """Largest change of the logarithm of a parameter."""


SETTINGS = ChangeSettings()


@dataclass(frozen=True, eq=False)
class ChangedParameters:
    """The changed parameters of a model."""

    model: StageModel
    """Model with the changed parameters; the given model if no change is significant."""
    changes: dict[str, tuple[float, float]]
    """Value before and after the change by parameter name, which ends in the unit."""
    before_rms_um: float
    after_rms_um: float
    """RMS of the residual on the held-out stretches."""

    @property
    def sentence(self) -> str:
        """Describe the change in one sentence."""
        if not self.changes:
            return "no parameter of the model explains the change"
        changed = ", ".join(f"{name} from {before:.6g} to {after:.6g}"
                            for name, (before, after) in self.changes.items())
        return (f"changed {changed}: the residual falls from {1e3 * self.before_rms_um:.3g} to "
                f"{1e3 * self.after_rms_um:.3g} nm")


def changed_parameters(model: StageModel, recording: Recording) -> ChangedParameters:
    """Find which parameters of a model have changed in a recording.

    Parameters
    ----------
    recording : Recording
        Recording after the change, including the voltages before it.

    Raises
    ------
    ValueError
        If the recording has gaps, or is too short.
    """
    problem = _Problem(model, with_outliers_marked(recording))
    groups = parameter_groups(model)
    chosen: tuple[str, ...] = ()
    numbers = np.empty(0)
    best = problem.residual_um(chosen, numbers)
    for _ in range(SETTINGS.most_groups):
        fits = {(*chosen, name): problem.fit(
            (*chosen, name), np.append(numbers, np.zeros(len(groups[name]))))
            for name in groups if name not in chosen}
        if not fits:
            break
        residual = {names: problem.residual_um(names, fit) for names, fit in fits.items()}
        names = min(residual, key=lambda key: problem.held_out_rms_um(residual[key]))
        if not problem.is_better(residual[names], best):
            break
        chosen, numbers, best = names, fits[names], residual[names]
    before_um = problem.held_out_rms_um(problem.residual_um((), np.empty(0)))
    if not chosen:
        return ChangedParameters(model, {}, before_um, before_um)
    found = problem.model(chosen, numbers)
    before, after = (_values(one) for one in (model, found))
    return ChangedParameters(
        found, {name: (before[name], after[name]) for group in chosen for name in groups[group]},
        before_um, problem.held_out_rms_um(best))


def parameter_groups(model: StageModel) -> dict[str, tuple[str, ...]]:
    """Return the groups of parameters that change together, by name of the group."""
    groups: dict[str, tuple[str, ...]] = {"gain": ("gain_um_per_v",)}
    if model.dynamics.time_constant_s > 0.0:
        groups["lag"] = ("time_constant_s",)
    return groups | {
        f"mode {index}": (f"mode_{index}_frequency_rad_per_s", f"mode_{index}_damping_ratio")
        for index in range(1, len(model.dynamics.damping_ratios) + 1)}


def _of_dynamics(model: StageModel) -> list[str]:
    """Return the names of the parameters in the order of `dynamics_vector`."""
    modes = range(1, len(model.dynamics.damping_ratios) + 1)
    return ["time_constant_s", *(f"mode_{index}_frequency_rad_per_s" for index in modes),
            *(f"mode_{index}_damping_ratio" for index in modes)]


def _values(model: StageModel) -> dict[str, float]:
    hysteresis, names = model.hysteresis, _of_dynamics(model)
    low_um, high_um = hysteresis.output_range_um
    gain_um_per_v = (high_um - low_um) / (hysteresis.voltage_max_v - hysteresis.voltage_min_v)
    return {"gain_um_per_v": float(gain_um_per_v)} | dict(
        zip(names, dynamics_vector(model.dynamics)[: len(names)].tolist(), strict=True))


def _changed(model: StageModel, logarithms: dict[str, float]) -> StageModel:
    """Return the model with some parameters multiplied by the exponentials of `logarithms`."""
    dynamics, hysteresis, names = model.dynamics, model.hysteresis, _of_dynamics(model)
    vector = dynamics_vector(dynamics)
    vector[: len(names)] *= np.exp([logarithms.get(name, 0.0) for name in names])
    if "gain_um_per_v" in logarithms:
        hysteresis = hysteresis.scaled(float(np.exp(logarithms["gain_um_per_v"])))
    return replace(model, hysteresis=hysteresis, dynamics=dynamics_of_vector(
        vector, len(dynamics.damping_ratios), len(dynamics.antiresonance_damping_ratios)))


class _Problem:
    """A recording, and the residual of a model with changed parameters."""

    def __init__(self, model: StageModel, recording: Recording) -> None:
        self._model = model
        self._part = part = simulated_recording(model, recording)
        count = part.time_s.size
        stretch = np.arange(count) * SETTINGS.stretches // count
        used = (np.arange(count) >= part.begin) & ~part.outlier
        self._held_out: BoolArray = used & (stretch % 3 == 2)
        self._fitted: BoolArray = used & ~self._held_out
        self._stretch = stretch
        self._nuisance = part.nuisance_regressors(np.arange(count))

    def model(self, groups: Sequence[str], numbers: FloatArray) -> StageModel:
        """Return the model with the parameters of some groups changed by logarithms."""
        known = parameter_groups(self._model)
        names = [name for group in groups for name in known[group]]
        return _changed(self._model, dict(zip(names, numbers, strict=True)))

    def residual_um(self, groups: Sequence[str], numbers: FloatArray) -> FloatArray:
        """Return the residual (N,), with offset and initial creep projected out."""
        part = self._part.with_model(self.model(groups, numbers))
        residual_um = part.measured_um - part.simulate()
        fitted = self._fitted
        solved = np.linalg.lstsq(self._nuisance[fitted], residual_um[fitted], rcond=1e-9)[0]
        return residual_um - self._nuisance @ solved

    def fit(self, groups: Sequence[str], start: FloatArray) -> FloatArray:
        """Return the logarithms that minimize the residual on the fitted stretches."""
        most = SETTINGS.largest_logarithm
        return least_squares(
            lambda numbers: self.residual_um(groups, numbers)[self._fitted], start,
            bounds=(-most, most), x_scale=0.01, diff_step=1e-4, xtol=1e-6, ftol=1e-6).x

    def held_out_rms_um(self, residual_um: FloatArray) -> float:
        """Return the root mean square of a residual on the held-out stretches."""
        return float(np.sqrt(np.mean(residual_um[self._held_out] ** 2)))

    def is_better(self, residual_um: FloatArray, than_um: FloatArray) -> bool:
        """Return whether a residual is significantly smaller than another on the stretches."""
        gains = np.array([
            np.mean(than_um[rows] ** 2 - residual_um[rows] ** 2)
            for stretch in range(2, SETTINGS.stretches, 3)
            if np.any(rows := self._held_out & (self._stretch == stretch))])
        error = float(np.std(gains, ddof=1)) / np.sqrt(gains.size)
        return bool(gains.mean() > SETTINGS.significant * error)
