# SPDX-License-Identifier: BSD-3-Clause
"""Record and diagnose a short case."""

import numpy as np

from piezo_identification.diagnosis.diagnose import diagnose
from piezo_identification.diagnosis.evidence.known_noise import noise_of_model
from piezo_identification.diagnosis.report.diagnosis_results import stated_error_um
from piezo_identification.fitting.dataset import simulate_recordings
from piezo_identification.fitting.regression import first_regression
from piezo_studies.diagnosis_benchmark import records
from piezo_studies.diagnosis_benchmark.coverage import OF_ANOTHER_FORM, estimates
from piezo_studies.diagnosis_benchmark.effect_draws import response_um
from piezo_studies.diagnosis_benchmark.nearest_effect import nearest_parameters
from piezo_studies.diagnosis_benchmark.plants import draw_plant, noise_um
from piezo_studies.diagnosis_benchmark.run_case import described, drawn_effect
from piezo_studies.diagnosis_benchmark.short_cases import waveform


def run_short_case(case, clean):
    """Record a short case, diagnose the recording, and return the result.

    Parameters
    ----------
    clean : (IdentifiedModel, tuple of Recording)
        Model and recordings of the plant without effects; only the model is used.

    Returns
    -------
    dict
        Those parts of the result of `run_case` that are needed to evaluate statements and
        intervals.
    """
    (identified, _), plant, experiment = clean, draw_plant((case.seed, case.plant)), waveform(case)
    seed, noise = int(case.random("noise").integers(2**31)), noise_um(plant)
    voltage_v, _ = records.commanded(experiment)
    surroundings = records.surroundings(experiment, seed)
    drawn = [drawn_effect(cause, plant, voltage_v, surroundings, multiple, seed,
                          records.clock_samples(experiment))
             for cause, multiple in zip(case.causes, case.multiples, strict=True)]
    hidden = drawn[-1].plant if drawn else plant
    recording = records.record(hidden, experiment, seed)
    diagnosis = diagnose(identified.model, [recording], stated_um=stated_error_um(identified),
                         noise=noise_of_model(identified))
    contributions, estimated = [], []
    for effect in drawn:
        without_um, added_um = _responses_um(plant, hidden, experiment, seed, recording)
        contributions.append({
            "cause": effect.cause, "effect": repr(effect.effect),
            "over_noise": _shown_um(identified.model, recording, added_um) / noise,
            "whole_over_noise": effect.contribution_rms_um / noise})
        estimated += estimates(effect.cause, effect.effect, diagnosis.effects, _nearest(
            effect.cause, diagnosis, without_um, added_um, recording.sample_period_s))
    return described(case, contributions, identified, diagnosis, estimated, noise)


def _responses_um(plant, changed, experiment, seed, recording):
    """Return the noise-free response of a plant, and the contribution of a change, (N,) each."""
    voltage_v, _ = records.commanded(experiment)
    surroundings = records.surroundings(experiment, seed)
    without_um, with_it_um = (
        response_um(stage, voltage_v, surroundings, records.clock_samples(experiment))[
            recording.playing]
        for stage in (plant, changed))
    return without_um, with_it_um - without_um


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
