# SPDX-License-Identifier: BSD-3-Clause
"""Record and diagnose a short case."""

import numpy as np

from piezo_identification.diagnosis.diagnose import diagnose
from piezo_identification.diagnosis.evidence.known_noise import noise_of_model
from piezo_identification.diagnosis.report.diagnosis_results import stated_error_um
from piezo_identification.experiments.catalogue import Experiment
from piezo_identification.fitting.dataset import simulate_recordings
from piezo_identification.fitting.regression import first_regression
from piezo_studies.diagnosis_benchmark import records
from piezo_studies.diagnosis_benchmark.cases import FAST_ONLY, SLOW_ONLY, Case
from piezo_studies.diagnosis_benchmark.coverage import (
    OF_ANOTHER_FORM,
    estimates,
    nearest_parameters,
)
from piezo_studies.diagnosis_benchmark.effect_draws import CAUSES, CAUSES_OUTSIDE
from piezo_studies.diagnosis_benchmark.plants import draw_plant, noise_um
from piezo_studies.diagnosis_benchmark.run_case import described, drawn_effects, responses_um

PLANTS = 5
"""Number of plants for a seed; few, as an identification takes as long as a dozen diagnoses."""
NONE_SHARE, OUTSIDE_SHARE = 0.15, 0.1
WEAKEST, STRONGEST = 0.3, 40.0
"""Bounds of the contribution to the recording over the noise; the smallest is undetectable."""
RATES_HZ = (10_000.0, 1000.0)
DURATIONS_S = (0.5, 5.0)
"""Sample rates, and durations, of a fast logger and of a slow one."""
KINDS = ("scan", "sweep", "levels", "tones")
LEVELS = 40
TONES = 12


def draw_short_cases(count, seed):
    """Draw cases with one effect or none, which appeared after the identification."""
    return [_drawn(number, seed) for number in range(count)]


def _drawn(number, seed):
    """Draw one case; it does not depend on the number of other cases."""
    random = np.random.default_rng([seed, number, *b"small case"])
    share = random.random()
    causes: tuple[str, ...] = ()
    if share > NONE_SHARE:
        kinds = CAUSES_OUTSIDE if share < NONE_SHARE + OUTSIDE_SHARE else CAUSES
        causes = (str(random.choice(list(kinds))),)
    multiple = float(np.exp(random.uniform(np.log(WEAKEST), np.log(STRONGEST))))
    is_slow = str(random.choice(["fast", "slow"])) == "slow"
    if (FAST_ONLY | SLOW_ONLY).intersection(causes):
        is_slow = bool(SLOW_ONLY.intersection(causes))
    return Case(number, seed, number % PLANTS, causes, (multiple,) * len(causes),
                str(random.choice(KINDS)), is_slow, later=True)


def waveform(case):
    """Return the experiment of a case, a waveform within 5 to 95 V."""
    random, rate_hz = case.random("waveform"), RATES_HZ[case.slow]
    duration_s = DURATIONS_S[case.slow]
    time_s = np.arange(round(duration_s * rate_hz)) / rate_hz
    shape = {"scan": _scan, "sweep": _sweep, "levels": _levels, "tones": _tones}[case.kind]
    line = shape(random, time_s / duration_s)
    line = line / np.abs(line).max()
    middle_v, reach_v = random.uniform(40.0, 60.0), random.uniform(20.0, 35.0)
    return Experiment(case.kind, middle_v + reach_v * line, 1.0 / rate_hz, 1, "")


def _scan(random, turn):
    """Return a rounded scan line of some periods with a superposed faster sine."""
    periods = random.uniform(4.0, 10.0)
    triangle = 4.0 * np.abs(periods * turn % 1.0 - 0.5) - 1.0
    return (np.sin(0.5 * np.pi * triangle)
            + 0.15 * np.sin(2.0 * np.pi * periods * random.uniform(4.0, 12.0) * turn))


def _sweep(random, turn):
    """Return a sine with rising frequency, over two decades, and falling amplitude."""
    first, ratio = random.uniform(1.0, 3.0), np.log(random.uniform(60.0, 200.0))
    phase = 2.0 * np.pi * first * np.expm1(ratio * turn) / ratio
    return np.cos(phase) / (1.0 + np.exp(ratio * turn) / 40.0)


def _levels(random, turn):
    """Return levels connected by ramps that take an eighth of the time of a level."""
    levels = random.uniform(-1.0, 1.0, LEVELS + 1)
    number = np.minimum((turn * LEVELS).astype(int), LEVELS - 1)
    moved = np.minimum(8.0 * (turn * LEVELS - number), 1.0)
    return levels[number] + moved * (levels[number + 1] - levels[number])


def _tones(random, turn):
    """Return tones over two decades with amplitudes that fall with frequency."""
    orders = np.unique(np.round(np.geomspace(2.0, random.uniform(100.0, 300.0), TONES)))
    phases = random.uniform(0.0, 2.0 * np.pi, orders.size)
    return np.sum([np.sin(2.0 * np.pi * order * turn + phase) / np.sqrt(order)
                   for order, phase in zip(orders, phases, strict=True)], axis=0)


def run_short_case(case, clean):
    """Record and diagnose a short case; return those parts of `run_case` that statements need.

    Of the plant without effects only the model is used, not its recordings.
    """
    (identified, _), plant, experiment = clean, draw_plant((case.seed, case.plant)), waveform(case)
    seed, noise = int(case.random("noise").integers(2**31)), noise_um(plant)
    drawn, hidden = drawn_effects(case, plant, experiment, seed)
    recording = records.record(hidden, experiment, seed)
    diagnosis = diagnose(identified.model, [recording], stated_um=stated_error_um(identified),
                         noise=noise_of_model(identified))
    contributions, estimated = [], []
    for effect in drawn:
        without_um, added_um = responses_um(plant, hidden, experiment, seed, recording)
        contributions.append({
            "cause": effect.cause, "effect": repr(effect.effect),
            "over_noise": _shown_um(identified.model, recording, added_um) / noise,
            "whole_over_noise": effect.contribution_rms_um / noise})
        estimated += estimates(effect.cause, effect.effect, diagnosis.effects, _nearest(
            effect.cause, diagnosis, without_um, added_um, recording.sample_period_s))
    return described(case, contributions, identified, diagnosis, estimated, noise)


def _shown_um(model, recording, added_um):
    """Return the RMS of an effect's contribution that nothing else explains on the fitted rows.

    Offset, initial creep and changes of the model within their prior are projected out.
    """
    regression = first_regression(simulate_recordings(model, [recording]))
    rows, tolerance_um = regression.dataset.rows[0], regression.tolerance_um
    residual = regression.remainder(added_um[rows] / tolerance_um)[
        : np.count_nonzero(regression.estimation)]
    return float(np.sqrt(np.mean((residual * tolerance_um[regression.estimation]) ** 2)))


def _nearest(cause, diagnosis, without_um, added_um, sample_period_s):
    """Return the expected parameters of an effect named in another form; None for others."""
    selection = diagnosis.selection
    found = next((effect for effect in selection.end.effects if effect.name == cause), None)
    if cause not in OF_ANOTHER_FORM or found is None:
        return None
    return nearest_parameters(found, without_um, added_um, sample_period_s, selection.regression)
