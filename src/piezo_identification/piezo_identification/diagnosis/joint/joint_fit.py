# SPDX-License-Identifier: BSD-3-Clause
"""Model and effects estimated together on several recordings, by Gauss-Newton steps."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezo_common.arrays import BoolArray, FloatArray
from piezo_identification.diagnosis.candidates.effect_fit import fit_effects
from piezo_identification.diagnosis.joint.free_parameters import changed_model, free_sensitivities
from piezo_identification.diagnosis.residual.dataset import Dataset, simulate_recordings
from piezo_identification.diagnosis.residual.noise_estimate import NoiseEstimate, estimate_noise
from piezo_identification.diagnosis.residual.regression import SETTINGS as TOLERANCE
from piezo_identification.diagnosis.residual.regression import Fit, Regression
from piezo_identification.diagnosis.residual.simulated_recording import SimulatedRecording
from piezo_models.cascade import StageModel
from piezo_models.effects import Effect, fitted_values
from piezo_recorder.reading.recording import Recording


@dataclass(frozen=True)
class JointSettings:
    """How far a joint fit goes.

    Attributes
    ----------
    steps : int
        Gauss-Newton steps of the model's parameters; derivatives are those at the start.
    worthwhile : float
        Part below which a step must bring the weighted sum of squares for another to follow.
    damping : tuple of float
        Widths by which the prior is narrower, one after another, until a step gains.
    blocks : tuple of int
        Neighbouring rows whose means tell how far errors are alike.
    fewest_blocks : int
        Of a recording, for their means to tell it.
    """

    steps: int = 3
    worthwhile: float = 0.98
    damping: tuple[float, ...] = (1.0, 10.0, 100.0)
    blocks: tuple[int, ...] = (10, 100, 1000)
    fewest_blocks: int = 10


SETTINGS = JointSettings()


@dataclass(frozen=True, eq=False)
class JointFit:
    """A model and effects that were estimated together.

    Attributes
    ----------
    regression : Regression
        With the model's parameters as estimated beside the effects.
    effects : tuple of piezo_models.effects.effect.Effect
        In all recordings, but for those that came later.
    later : frozenset of str
        Names of the effects that are in the new recordings only.
    covariance : (p, p) array or None
        Of the fitted values of the effects.
    has_converged : bool
        False if the last step gained so much that another would gain as well.
    """

    regression: Regression
    effects: tuple[Effect, ...]
    later: frozenset[str]
    covariance: FloatArray | None = None
    has_converged: bool = True

    @property
    def model(self) -> StageModel:
        """Return the model of the stage as it is now, effects and all."""
        model = self.regression.dataset.model
        return replace(model, effects=(*model.effects, *self.effects))

    @property
    def count(self) -> int:
        """Return how many numbers of effects were fitted."""
        return sum(fitted_values(effect)[0].size for effect in self.effects)

    def left_um(self) -> list[tuple[FloatArray, BoolArray]]:
        """Return what is left at the rows of each recording, and which of them are held out."""
        regression = self.regression
        left_um = _left_um(regression, self.effects)
        good = regression.estimation | regression.validation
        return [(left_um[mask & good], regression.validation[mask & good])
                for mask in regression.dataset.masks()]


class RecordingBefore(SimulatedRecording):
    """A recording that was made before some effects came."""

    later: frozenset[str] = frozenset()

    def simulate(self, effects: Sequence[Effect] = (), quick: Sequence[Effect] = ()) -> FloatArray:
        """Return the displacement with those effects that did not come later."""
        return super().simulate(*(
            tuple(effect for effect in some if effect.name not in self.later)
            for some in (effects, quick)))


class JointProblem:
    """Recordings, a model from which fits begin, and its derivatives.

    Parameters
    ----------
    model : StageModel
        Its own effects are fitted with the others.
    new : sequence of Recording
        With the sign of the model, and their outliers marked.
    old : sequence of Recording
        Those that the model was identified from.
    undivided : int
        New ones that count with as many rows each as all others together.
    steps : int
        Gauss-Newton steps of a fit.
    """

    def __init__(self, model: StageModel, new: Sequence[Recording],
                 old: Sequence[Recording], undivided: int = 0,
                 steps: int = SETTINGS.steps) -> None:
        self.own, self.new_count = model.effects, len(new)
        self.undivided, self.steps = undivided, steps
        self.dataset = simulate_recordings(
            replace(model, effects=()), [*new, *old], sensitivities=free_sensitivities,
            undivided=undivided)
        self.noise = estimate_noise(self.dataset, self.own)
        first = _weighed(self.dataset, self.noise, _scale_um(self.dataset, self.noise))
        left_um = first.fit(self.own).residual * first.tolerance_um
        self.start = _weighed(
            self.dataset, self.noise, _scale_um(self.dataset, self.noise, left_um))

    def about(self, fit: JointFit) -> "JointProblem":
        """Return the problem with its derivatives at the model of a fit, from which fits begin."""
        recordings = self.dataset.recordings
        return JointProblem(fit.model, recordings[: self.new_count], recordings[self.new_count :],
                            self.undivided, self.steps)

    def fit(self, effects: Sequence[Effect], later: Iterable[str] = ()) -> JointFit:
        """Fit the model's parameters and those of effects, from where these are.

        Parameters
        ----------
        effects : sequence of piezo_models.effects.effect.Effect
            All of them, the model's own as well.
        later : iterable of str
            Names of the effects that came after the identification.

        Returns
        -------
        JointFit
        """
        came = frozenset(later)
        regression = self.start
        if came:
            regression = replace(regression, dataset=self._at(self.dataset.model, came))
        found = JointFit(regression, tuple(effects), came)
        least = _mean_logarithm(regression, found.effects)
        for step in range(self.steps):
            fit = fit_effects(regression, found.effects, quick=step == 0) if effects else (
                regression.fit(()))
            moved, now = self._step(regression, fit, came)
            if now >= least:
                break
            is_last = now > least + np.log(SETTINGS.worthwhile)
            found = JointFit(moved, fit.effects, came, fit.covariance, is_last)
            if is_last:
                break
            least, regression = now, _reweighed(moved, fit.effects)
        return found

    def _step(self, regression: Regression, fit: Fit,
              later: frozenset[str]) -> tuple[Regression, float]:
        """Change the model's parameters beside effects as they are, less where that is too far."""
        best, least = regression, _mean_logarithm(regression, fit.effects)
        for damping in SETTINGS.damping:
            damped = fit if damping == 1.0 else _weighed(
                regression.dataset, self.noise, regression.tolerance_um, damping).fit(fit.effects)
            model = changed_model(
                regression.dataset.model, damped.coefficients[self.dataset.nuisance_count :])
            tried = replace(regression, dataset=self._at(model, later))
            now = _mean_logarithm(tried, fit.effects)
            if now < least:
                return tried, now
        return best, least

    def _at(self, model: StageModel, later: frozenset[str]) -> Dataset:
        """Simulate another model on the same rows."""
        simulated = []
        for number, (recording, part) in enumerate(
                zip(self.dataset.recordings, self.dataset.simulated, strict=True)):
            kind = SimulatedRecording if number < self.new_count else RecordingBefore
            simulated.append(kind(model, recording, part.past_v))
            if isinstance(simulated[-1], RecordingBefore):
                simulated[-1].later = later
        return replace(self.dataset, model=model, simulated=tuple(simulated))


def _left_um(regression: Regression, effects: Sequence[Effect]) -> FloatArray:
    return regression.tolerance_um * regression.nuisance_remainder(regression.difference(effects))


def _mean_logarithm(regression: Regression, effects: Sequence[Effect]) -> float:
    """Return the mean over the recordings of the logarithm of the mean square that is left.

    Less than the accuracy of a good model is no gain, as in the evidence.
    """
    left_um, dataset = _left_um(regression, effects), regression.dataset
    return float(np.mean([
        np.log(np.mean(left_um[mask & regression.estimation] ** 2)
               + (TOLERANCE.model_tolerance * np.ptp(part.measured_um)) ** 2)
        for mask, part in zip(dataset.masks(), dataset.simulated, strict=True)]))


def correlated_scale(residual: FloatArray) -> float:
    """Return the RMS of a residual, times the root of how many neighbours err alike.

    Parameters
    ----------
    residual : (N,) array

    Returns
    -------
    float
        Of white noise its standard deviation. The variance of a mean over a long block is that of
        white noise of this standard deviation, over the length of the block.
    """
    squares = [np.mean(residual**2)]
    for length in SETTINGS.blocks:
        blocks = residual[: residual.size // length * length].reshape(-1, length)
        if len(blocks) >= SETTINGS.fewest_blocks:
            squares.append(length * np.mean(blocks.mean(axis=1) ** 2))
    return float(np.sqrt(max(squares)))


def _scale_um(dataset: Dataset, noise: NoiseEstimate,
              left_um: FloatArray | None = None) -> FloatArray:
    """Return the scale of each row, so that rows count for as many as err independently, (r,).

    It is the tolerance of the recording, or more where more is left.
    """
    good = dataset.for_estimation & ~dataset.at_rows(noise.outliers)
    scales = []
    for part, noise_um, mask in zip(
            dataset.simulated, noise.noise_um, dataset.masks(), strict=True):
        least_um = np.hypot(noise_um, TOLERANCE.model_tolerance * np.ptp(part.measured_um))
        scales.append(least_um if left_um is None else max(
            least_um, correlated_scale(left_um[mask & good])))
    return dataset.of_each(scales)


def _reweighed(regression: Regression, effects: Sequence[Effect]) -> Regression:
    """Weigh the rows by what is left beside effects."""
    dataset, noise = regression.dataset, regression.noise
    return _weighed(dataset, noise, _scale_um(dataset, noise, _left_um(regression, effects)))


def _weighed(dataset: Dataset, noise: NoiseEstimate, scale_um: FloatArray,
             damping: float = 1.0) -> Regression:
    """Weigh the rows by their scales; the prior of one width matters where no recording tells."""
    good = ~dataset.at_rows(noise.outliers)
    estimation, validation = dataset.for_estimation & good, ~dataset.for_estimation & good
    weighted = dataset.regressors / scale_um[:, None]
    prior = damping * np.eye(weighted.shape[1])[dataset.nuisance_count :]
    q, r = np.linalg.qr(np.vstack([weighted[estimation], prior]))
    return Regression(dataset, noise, scale_um, estimation, validation, weighted, prior, q, r)
