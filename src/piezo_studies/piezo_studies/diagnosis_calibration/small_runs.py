# SPDX-License-Identifier: BSD-3-Clause
"""Record and diagnose a small case."""

import numpy as np

from piezo_identification.diagnosis.diagnose import diagnose
from piezo_identification.diagnosis.evidence.known_noise import noise_of_model
from piezo_identification.diagnosis.report.results import stated_error_um
from piezo_identification.fitting.dataset import simulate_recordings
from piezo_identification.fitting.regression import first_regression
from piezo_studies.diagnosis_benchmark import records
from piezo_studies.diagnosis_benchmark.coverage import OF_ANOTHER_FORM, estimates
from piezo_studies.diagnosis_benchmark.effect_draws import DrawError, draw_effect, response_um
from piezo_studies.diagnosis_benchmark.nearest_effect import nearest_parameters
from piezo_studies.diagnosis_benchmark.plants import draw_plant, noise_um
from piezo_studies.diagnosis_calibration.small_cases import waveform

TRIES = 8
"""Most contributions tried, each half the one before, until the recording can show the effect."""


def run_small_case(case, identified):
    """Record a case, diagnose the recording, and return the result.

    Parameters
    ----------
    identified : IdentifiedModel
        Model of the plant without effects.

    Returns
    -------
    dict or None
        Those parts of the result of `diagnosis_benchmark.run_case.run_case` that are needed to
        evaluate statements and intervals; None if the waveform does not show the cause at all.
    """
    plant, experiment = draw_plant((case.seed, case.plant)), waveform(case)
    seed = int(case.random("noise").integers(2**31))
    noise, drawn = noise_um(plant), None
    if case.cause is not None:
        drawn = _drawn(case, plant, experiment, seed)
        if drawn is None:
            return None
    recording = records.record(plant if drawn is None else drawn.plant, experiment, seed)
    diagnosis = diagnose(identified.model, [recording], stated_um=stated_error_um(identified),
                         noise=noise_of_model(identified))
    size, estimated = 0.0, []
    if drawn is not None:
        without_um, added_um = _responses_um(plant, drawn.plant, experiment, seed, recording)
        size = _shown_um(identified.model, recording, added_um) / noise
        estimated = estimates(case.cause, drawn.effect, diagnosis.effects, _nearest(
            case.cause, diagnosis, without_um, added_um, recording.sample_period_s))
    return {
        "number": case.number, "kind": case.kind, "logger": case.logger,
        "model": "identified before",
        "contributions": [] if drawn is None else [
            {"cause": case.cause, "effect": repr(drawn.effect), "over_noise": size,
             "whole_over_noise": drawn.contribution_rms_um / noise}],
        "in_model": [effect.name for effect in identified.model.effects],
        "verdict": diagnosis.verdict, "probabilities": diagnosis.probabilities,
        "effects": [entry["name"] for entry in diagnosis.effects],
        "not_decidable": sorted(diagnosis.not_decidable),
        "estimates": estimated,
        "noise_um": noise, "noise_found_um": diagnosis.noise_floor_um,
        "before_um": diagnosis.before["rms_um"], "after_um": diagnosis.after["rms_um"],
    }


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


def _drawn(case, plant, experiment, seed):
    """Draw the effect; halve its contribution until the recording can show it."""
    voltage_v, _ = records.commanded(experiment)
    surroundings = records.surroundings(experiment, seed)
    for halved in range(TRIES):
        try:
            return draw_effect(case.cause, plant, voltage_v, surroundings,
                               case.multiple * 0.5**halved, seed,
                               records.clock_samples(experiment))
        except DrawError:
            continue
    return None
