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

from piezo_common.arrays import FloatArray
from piezo_identification.conditioning.outlier_samples import with_outliers_marked
from piezo_identification.diagnosis.comparison.criteria import is_convincing, mean_square
from piezo_identification.fitting.dataset import simulate_recordings
from piezo_identification.fitting.regression import Fit, first_regression
from piezo_models.cascade import StageModel
from piezo_models.linear.dynamics_vector import dynamics_of_vector, dynamics_vector
from piezo_recorder.reading.recording import Recording

MOST_GROUPS = 2
"""Most groups of parameters that may have changed at once."""

LARGEST_LOGARITHM = 0.5
"""Largest change of the logarithm of a parameter."""


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

    The recording was made after the change, and includes the voltages before it. Raise ValueError
    if it has gaps, or is too short.
    """
    problem = _Problem(model, with_outliers_marked(recording))
    groups = parameter_groups(model)
    chosen: tuple[str, ...] = ()
    numbers = np.empty(0)
    regression, start = problem.regression, problem.fit(chosen, numbers)
    best = start
    for _ in range(MOST_GROUPS):
        found_numbers = {(*chosen, name): problem.best(
            (*chosen, name), np.append(numbers, np.zeros(len(groups[name]))))
            for name in groups if name not in chosen}
        if not found_numbers:
            break
        fits = {names: problem.fit(names, each) for names, each in found_numbers.items()}
        names = min(fits, key=lambda key: mean_square(regression, fits[key]))
        if not is_convincing(regression, start, best, fits[names]):
            break
        chosen, numbers, best = names, found_numbers[names], fits[names]
    before_um = regression.residual_um(start)
    if not chosen:
        return ChangedParameters(model, {}, before_um, before_um)
    found = problem.model(chosen, numbers)
    before, after = (_values(one) for one in (model, found))
    return ChangedParameters(
        found, {name: (before[name], after[name]) for group in chosen for name in groups[group]},
        before_um, regression.residual_um(best))


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
    names = _of_dynamics(model)
    return {"gain_um_per_v": model.hysteresis.mean_gain_um_per_v} | dict(
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
    """A recording, and fits of a model with changed parameters to it."""

    def __init__(self, model: StageModel, recording: Recording) -> None:
        self._model = model
        # The parameters that may have changed are not linear.
        self.regression = first_regression(simulate_recordings(
            model, [recording], sensitivities=lambda part, rows: np.empty((rows.size, 0))))

    def model(self, groups: Sequence[str], numbers: FloatArray) -> StageModel:
        """Return the model with the parameters of some groups changed by logarithms."""
        known = parameter_groups(self._model)
        names = [name for group in groups for name in known[group]]
        return _changed(self._model, dict(zip(names, numbers, strict=True)))

    def fit(self, groups: Sequence[str], numbers: FloatArray) -> Fit:
        """Return the residual of the changed model, with offset and initial creep fitted."""
        dataset = self.regression.dataset
        part = dataset.simulated[0].with_model(self.model(groups, numbers))
        return replace(self.regression, dataset=replace(dataset, simulated=(part,))).as_given()

    def best(self, groups: Sequence[str], start: FloatArray) -> FloatArray:
        """Return the logarithms that minimise the residual on the fitted stretches."""
        return least_squares(
            lambda numbers: self.fit(groups, numbers).residual[self.regression.estimation], start,
            bounds=(-LARGEST_LOGARITHM, LARGEST_LOGARITHM), x_scale=0.01, diff_step=1e-4,
            xtol=1e-6, ftol=1e-6).x
