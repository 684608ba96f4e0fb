# SPDX-License-Identifier: BSD-3-Clause
"""How well a waveform would distinguish alternative explanations, before it is played.

Two alternatives predict the response to a waveform. The parameters of the wrong one are fitted to
the prediction of the other, as far as the recordings so far allow. The remaining difference,
relative to the expected errors, is their distance (Box and Hill, Discrimination among mechanistic
models, Technometrics 9, 1967).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from piezo_common.arrays import FloatArray
from piezo_common.long_matrix import triangle_of
from piezo_identification.diagnosis.evidence.effect_covariance import sensitivities
from piezo_identification.diagnosis.experiment_design.alternative_explanations import (
    Alternatives,
)
from piezo_identification.experiments.catalogue import Experiment
from piezo_identification.experiments.stage_limits import StageLimits
from piezo_identification.fitting.dataset import SPLIT, simulate_recordings
from piezo_identification.fitting.free_parameters import free_sensitivities
from piezo_identification.fitting.regression import SETTINGS
from piezo_identification.simulation.simulated_recording import SimulatedRecording
from piezo_recorder.reading.recording import Recording
from piezo_recorder.sample_block import Flag

SURE = 0.95
"""Probability with which an alternative is decided for."""
RAMP_S = 0.1


@dataclass(frozen=True, eq=False)
class ExpectedOutcome:
    """Expected result of a waveform."""

    rms_um: FloatArray
    """RMS difference of the predictions of i and j, with the parameters of j fitted to i, (n,
    n)."""
    distance: FloatArray
    """The same in standard deviations of the errors, if i is true, (n, n)."""
    deciding: FloatArray
    """Probability that alternative i has 95 % after the recording, if it is true, (n,)."""
    probability: float
    """Probability that the recording decides, whichever is true."""

    @property
    def rank(self) -> tuple[float, float, float]:
        """Return the criterion for the best waveform: probability first, then the distance."""
        apart = ~np.eye(len(self.distance), dtype=bool)
        return (round(self.probability, 2), float(self.distance[apart].min()),
                float(self.rms_um[apart].min()))


def expected_outcome(alternatives: Alternatives, experiment: Experiment, limits: StageLimits,
                     is_refitted: bool = True) -> ExpectedOutcome:
    """Simulate a waveform with each alternative, and compare them.

    Without refitting, the parameters of the wrong alternative are fixed. That takes a fraction of
    the time, and alternatives are then at least as far apart.
    """
    known, count = alternatives.alternatives, len(alternatives.alternatives)
    problem, unplayed = alternatives.problem, _unplayed(experiment, limits)
    dataset = simulate_recordings(
        problem.dataset.model, [unplayed], past_v=(),
        sensitivities=free_sensitivities if is_refitted else _no_sensitivities)
    (given,), (rows,) = dataset.simulated, dataset.rows
    parts = [given.with_model(alternative.fit.regression.dataset.model) for alternative in known]
    predictions = [part.simulate(alternative.fit.effects)[rows]
                   for part, alternative in zip(parts, known, strict=True)]
    error_um = np.sqrt(alternatives.alike) * np.linalg.norm(np.array([
        _noise_um(alternatives, given.sample_period_s),
        SETTINGS.model_tolerance * max(np.ptp(predicted) for predicted in predictions),
        alternatives.misfit * max(np.std(predicted) for predicted in predictions)], dtype=float))
    regressors, of_effects = dataset.regressors, [np.zeros((rows.size, 0))] * count
    if is_refitted:
        # The model with its own effects is nearly the same in all of them.
        regressors = np.hstack([regressors, sensitivities(
            lambda own: given.simulate(own)[rows], problem.own)])
        of_effects = [sensitivities(
            lambda added, part=part, own=alternative.own: part.simulate((*own, *added))[rows],
            alternative.effects) for part, alternative in zip(parts, known, strict=True)]
    # In an orthonormal basis of all of them, the rows of the waveform become few.
    shared, *columns = _in_common_basis([regressors, *of_effects, *(
        (predicted / error_um)[:, np.newaxis] for predicted in predictions)])
    own, predicted = columns[:count], columns[count:]
    rms_um, distance = np.zeros((count, count)), np.zeros((count, count))
    for other, alternative in enumerate(known):
        fitted, root = np.hstack([shared, own[other]]) / error_um, alternative.information
        before = np.hstack([np.zeros((len(root), dataset.nuisance_count)), root])
        basis, _ = np.linalg.qr(np.vstack([fitted, before[:, : fitted.shape[1]]]))
        for true in set(range(count)) - {other}:
            difference = np.concatenate([
                predicted[true][:, 0] - predicted[other][:, 0], np.zeros(len(root))])
            remaining = difference - basis @ (basis.T @ difference)
            rms_um[true, other] = error_um * np.linalg.norm(
                remaining[: len(shared)]) / np.sqrt(rows.size)
            # Alternatives are compared on the held-out part of the data.
            distance[true, other] = np.linalg.norm(remaining) / np.sqrt(SPLIT.held_out)
    chances = np.array([alternative.probability for alternative in alternatives.alternatives])
    deciding = _deciding(distance, chances)
    # Chances sum to one except for rounding.
    return ExpectedOutcome(rms_um, distance, deciding, min(float(deciding @ chances), 1.0))


def _no_sensitivities(_: SimulatedRecording, rows: NDArray[np.intp]) -> FloatArray:
    """Return no columns, for fixed parameters."""
    return np.zeros((rows.size, 0))


def _in_common_basis(columns: list[FloatArray]) -> list[FloatArray]:
    """Return the columns in an orthonormal basis of all of them, which keeps their products."""
    triangle = triangle_of(np.hstack(columns))
    return np.hsplit(triangle, np.cumsum([each.shape[1] for each in columns])[:-1])


def _deciding(distance: FloatArray, chances: FloatArray) -> FloatArray:
    """Return the probability of deciding for each alternative if it is true, (n,).

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
    """Return the expected noise of a sample, not less than that of the recordings so far."""
    problem = alternatives.problem
    return max(
        noise_um * max(1.0, float(np.sqrt(part.sample_period_s / sample_period_s)))
        for part, noise_um in zip(
            problem.dataset.simulated[: problem.new_count], problem.noise.noise_um, strict=False))


def _unplayed(experiment: Experiment, limits: StageLimits) -> Recording:
    """Return the recording of an experiment from rest, before anything is measured."""
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
