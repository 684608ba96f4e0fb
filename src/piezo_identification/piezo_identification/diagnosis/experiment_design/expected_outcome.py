# SPDX-License-Identifier: BSD-3-Clause
"""How surely a waveform would tell alternative explanations apart, before it is played.

Two alternatives predict a waveform. The parameters of the wrong one are fitted to what the other
predicts, as far as the recordings so far let them move. What remains, over the errors to be
expected, is their distance (Box and Hill, Discrimination among mechanistic models, Technometrics
9, 1967).
"""

from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

from piezo_common.arrays import FloatArray
from piezo_identification.diagnosis.experiment_design.alternatives import (
    RESEMBLING,
    Alternative,
    Alternatives,
    sensitivities,
)
from piezo_identification.diagnosis.residual.dataset import SPLIT, simulate_recordings
from piezo_identification.diagnosis.residual.regression import SETTINGS
from piezo_identification.experiments.catalogue import Experiment
from piezo_identification.experiments.stage_limits import StageLimits
from piezo_recorder.reading.recording import Recording
from piezo_recorder.sample_block import Flag

SURE = 0.95
"""A alternative with this probability is decided for."""
RAMP_S = 0.1


@dataclass(frozen=True, eq=False)
class ExpectedOutcome:
    """What a waveform is expected to show.

    Attributes
    ----------
    rms_um : (n, n) array
        RMS difference of the predictions of i and j, the parameters of j fitted to i.
    distance : (n, n) array
        The same in standard deviations of the errors, where i is true.
    deciding : (n,) array
        Probability that alternative i has 95 % after the recording, if it is true.
    probability : float
        That the recording decides, whichever is true.
    """

    rms_um: FloatArray
    distance: FloatArray
    deciding: FloatArray
    probability: float

    @property
    def rank(self) -> tuple[float, float, float]:
        """Return what the best waveform has the most of: it decides, and by how much."""
        apart = ~np.eye(len(self.distance), dtype=bool)
        return (round(self.probability, 2), float(self.distance[apart].min()),
                float(self.rms_um[apart].min()))


def expected_outcome(alternatives: Alternatives, experiment: Experiment,
                     limits: StageLimits) -> ExpectedOutcome:
    """Simulate a waveform with each alternative, and compare them.

    Parameters
    ----------
    alternatives : Alternatives
    experiment : Experiment
    limits : StageLimits

    Returns
    -------
    ExpectedOutcome
    """
    old, count = alternatives.regression, len(alternatives.alternatives)
    dataset = simulate_recordings(
        old.dataset.model, [_unplayed(experiment, limits)], past_v=())
    part, rows = dataset.simulated[0], dataset.rows[0]
    nuisance = dataset.regressors[:, : dataset.nuisance_count]
    of_model = dataset.regressors[:, dataset.nuisance_count :]

    def predicted_um(alternative: Alternative) -> FloatArray:
        changes = alternative.fit.coefficients[old.dataset.nuisance_count :]
        return np.asarray(part.simulate(alternative.fit.effects)[rows] + of_model @ changes)

    predictions = [predicted_um(alternative) for alternative in alternatives.alternatives]
    tolerance_um = np.hypot(
        _noise_um(alternatives, part.sample_period_s),
        SETTINGS.model_tolerance * max(np.ptp(predicted) for predicted in predictions))
    rms_um, distance = np.zeros((count, count)), np.zeros((count, count))
    for other, alternative in enumerate(alternatives.alternatives):
        of_effects = sensitivities(
            lambda effects: part.simulate(effects)[rows], alternative.fit.effects)
        columns = np.hstack([nuisance, of_model, of_effects]) / tolerance_um
        known = np.hstack([
            np.zeros((len(alternative.information), nuisance.shape[1])), alternative.information])
        basis, _ = np.linalg.qr(np.vstack([columns, known]))
        for true, predicted in enumerate(predictions):
            if true != other:
                difference = np.concatenate([
                    (predicted - predictions[other]) / tolerance_um, np.zeros(len(known))])
                left = difference - basis @ (basis.T @ difference)
                rms_um[true, other] = tolerance_um * np.sqrt(np.mean(left[: rows.size] ** 2))
                misfit_um = RESEMBLING * alternatives.misfit * np.std(predicted)
                alike = misfit_um / tolerance_um * np.sqrt(rows.size)
                size = float(np.linalg.norm(left))
                # Alternatives are compared on the part of the data that is held out.
                apart = max(0.0, size * (size - 2.0 * alike))
                distance[true, other] = np.sqrt(
                    apart / (alternatives.variance * SPLIT.held_out))
    chances = np.array([alternative.probability for alternative in alternatives.alternatives])
    deciding = _deciding(distance, chances)
    return ExpectedOutcome(rms_um, distance, deciding, float(deciding @ chances))


def _deciding(distance: FloatArray, chances: FloatArray) -> FloatArray:
    """Return for each alternative how probably it is decided for if it is true, (n,).

    With Gaussian errors the logarithm of the ratio of two probabilities grows by half of the
    squared distance, with the distance as its standard deviation.
    """
    count = len(chances)
    needed = np.log(SURE / (1.0 - SURE) * max(1, count - 1))
    found = np.ones(count)
    for true in range(count):
        for other in range(count):
            if other != true:
                apart = max(distance[true, other], 1e-9)
                before = np.log(max(chances[true], 1e-12) / max(chances[other], 1e-12))
                found[true] = min(
                    found[true], norm.cdf((0.5 * apart**2 + before - needed) / apart))
    return found


def _noise_um(alternatives: Alternatives, sample_period_s: float) -> float:
    """Return the noise of a sample to be expected: not less than the recordings so far had."""
    regression = alternatives.regression
    return max(
        noise_um * max(1.0, float(np.sqrt(part.sample_period_s / sample_period_s)))
        for part, noise_um in zip(
            regression.dataset.simulated, regression.noise.noise_um, strict=True))


def _unplayed(experiment: Experiment, limits: StageLimits) -> Recording:
    """Return the recording of an experiment from rest, with nothing measured yet."""
    period_s = experiment.sample_period_s
    waveform_v = np.tile(experiment.voltage_v, experiment.repeats)
    samples = max(1, round(RAMP_S / period_s))
    ramp = np.arange(samples) / samples
    rest_v = limits.rest_voltage_v
    voltage_v = np.concatenate([rest_v + ramp * (waveform_v[0] - rest_v), waveform_v])
    flags = np.full(voltage_v.size, Flag.PLAYING, dtype=np.uint32)
    flags[:samples] = Flag.RAMPING
    held = max(1, round(period_s * limits.sample_rate_hz))
    return Recording(
        experiment.name, limits.sample_rate_hz, held * np.arange(voltage_v.size),
        np.full(voltage_v.size, period_s), voltage_v, np.zeros(voltage_v.size), flags)
