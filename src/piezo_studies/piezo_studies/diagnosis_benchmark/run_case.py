# SPDX-License-Identifier: BSD-3-Clause
"""Run one case: identify a model, record a plant with hidden effects, and diagnose it."""

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from piezo_identification.diagnosis.comparison.criteria import lack_of_fit
from piezo_identification.diagnosis.diagnose import diagnose
from piezo_identification.diagnosis.evidence.known_noise import noise_of_model
from piezo_identification.diagnosis.experiment_design.decide import decide
from piezo_identification.diagnosis.joint.identification_recordings import IdentificationRecordings
from piezo_identification.diagnosis.report.diagnosis_results import stated_error_um
from piezo_identification.estimators.creep.square_wave_creep import CreepNotShown
from piezo_identification.estimators.frequency_response.response_fit import ResponseOrder
from piezo_identification.fitting.dataset import simulate_recordings
from piezo_identification.fitting.parameter_sensitivities import parameter_sensitivities
from piezo_identification.fitting.regression import first_regression
from piezo_identification.identification.identify import identify
from piezo_studies.diagnosis_benchmark import records
from piezo_studies.diagnosis_benchmark.coverage import estimates
from piezo_studies.diagnosis_benchmark.effect_draws import (
    DrawError,
    DrawnEffect,
    draw_effect,
    response_um,
)
from piezo_studies.diagnosis_benchmark.plants import draw_plant, noise_um

STRUCTURE = ResponseOrder(creep_pairs=4, modes=2, antiresonances=0)
"""Structure of the models, reduced if the recordings do not show all of it."""

WEAKEST_MULTIPLE = 1e-2
"""Contribution over the noise below which a recording does not show an effect at all."""


def identified_model(plant, seed):
    """Identify a model of a plant with its effects from designed recordings; return both."""
    experiments = records.identification_experiments()
    with tempfile.TemporaryDirectory() as folder:
        recordings = {}
        for index, (name, experiment) in enumerate(experiments.items()):
            # The model stores the paths of its recordings, so they must exist.
            path = Path(folder) / name
            path.touch()
            recording = records.record(plant, experiment, 10 * seed + index)
            recordings[name] = replace(recording, path=str(path))
        return _identified(recordings, STRUCTURE), tuple(recordings.values())


def _identified(recordings, order):
    """Identify a model of an order, with fewer creep pairs if they are not identifiable."""
    try:
        return identify(**recordings, order=order)
    except CreepNotShown:
        return _identified(recordings, replace(order, creep_pairs=order.creep_pairs - 1))


def clean_model(seed, plant):
    """Return model and recordings of a plant without effects."""
    return identified_model(draw_plant((seed, plant)), 1000 * seed + plant)


def run_case(case, clean, experiments=0):
    """Record a drawn case, diagnose it, and return the result, which no machine changes.

    `clean` is the result of `clean_model`. Some proposed recordings may be made if alternatives
    remain.
    """
    plant = draw_plant((case.seed, case.plant))
    experiment = records.KINDS[case.kind](case.random("waveform"), case.slow)
    seed = int(case.random("noise").integers(2**31))
    drawn, hidden = drawn_effects(case, plant, experiment, seed)
    (model, _), (known, identified_from) = clean, clean
    if drawn and not case.later:
        known, identified_from = identified_model(hidden, seed % 2**20)
    recording = records.record(hidden, experiment, seed)
    diagnoses = _diagnoses(known, identified_from, recording, hidden, seed, experiments)
    diagnosis = diagnoses[-1]
    # The residual with perfect knowledge of the effects: same noise, no effect.
    perfect_um = _least_error_um(model.model, records.record(plant, experiment, seed))
    noise = noise_um(plant)
    contributions = []
    for effect, previous in zip(drawn, [plant, *(effect.plant for effect in drawn)], strict=False):
        _, added_um = responses_um(previous, effect.plant, experiment, seed, recording)
        part = diagnosis.selection.regression.dataset.simulated[0]
        beyond_um = _beyond_model_um(part, added_um)
        contributions.append({
            "cause": effect.cause, "effect": repr(effect.effect),
            "over_noise": effect.contribution_rms_um / noise,
            "beyond_model_over_noise": beyond_um / noise,
        })
    estimated = [each for effect in drawn for each in estimates(
        effect.cause, effect.effect, diagnosis.effects)]
    return {
        **described(case, contributions, known, diagnosis, estimated, noise),
        "experiments": len(diagnoses) - 1, "before_experiments": _reported(diagnoses[0]),
        "lacking_over_noise": _missing_um(diagnosis) / noise, "perfect_um": perfect_um,
    }


def described(case, contributions, identified, diagnosis, estimated, noise):
    """Return what the results of long and short cases have in common."""
    return {
        "number": case.number, "plant": case.plant, "kind": case.kind,
        "logger": "slow" if case.slow else "fast",
        "model": "identified before" if case.later else "identified with the effects",
        "contributions": contributions,
        "in_model": [effect.name for effect in identified.model.effects],
        **_reported(diagnosis), "estimates": estimated,
        "noise_um": noise, "noise_found_um": diagnosis.noise_floor_um,
        "before_um": diagnosis.before["rms_um"], "after_um": diagnosis.after["rms_um"],
    }


def _diagnoses(known, identified_from, recording, hidden, seed, experiments):
    """Return the diagnosis of a recording, and one after each proposed recording."""
    old, stated_um = IdentificationRecordings(identified_from, ()), stated_error_um(known)
    if not experiments:
        return [diagnose(known.model, [recording], identified_from=old, stated_um=stated_um,
                         noise=noise_of_model(known))]
    steps = decide(
        known.model, [recording], records.player_of_proposals(hidden, seed), experiments,
        records.STAGE_LIMITS, identified_from=old, stated_um=stated_um, noise=noise_of_model(known))
    return [step.diagnosis for step in steps]


def _reported(diagnosis):
    return {"verdict": diagnosis.verdict, "probabilities": diagnosis.probabilities,
            "effects": [entry["name"] for entry in diagnosis.effects],
            "not_decidable": sorted(diagnosis.not_decidable)}


def _least_error_um(model, recording):
    """Return the error on held-out data without effects, with the model's parameters tuned."""
    regression = first_regression(simulate_recordings(model, [recording]))
    return regression.residual_um(regression.fit(()))


def _missing_um(diagnosis):
    """Return the RMS of the tuned model's residual beyond the noise."""
    regression = diagnosis.selection.regression
    rms_tolerances = np.sqrt(lack_of_fit(regression, diagnosis.selection.start))
    return float(rms_tolerances * np.sqrt(np.mean(regression.tolerance_um**2)))


def drawn_effects(case, plant, experiment, seed):
    """Return the effects of a case, each drawn on the plant with the others, and the last plant.

    A contribution is halved until the recording can show it.
    """
    voltage_v, _ = records.commanded(experiment)
    surroundings = records.surroundings(experiment, seed)
    drawn: list[DrawnEffect] = []
    for index, (cause, multiple) in enumerate(zip(case.causes, case.multiples, strict=True)):
        while len(drawn) == index:
            try:
                drawn.append(draw_effect(cause, plant, voltage_v, surroundings, multiple,
                                         seed + index, records.clock_samples(experiment)))
            except DrawError:
                if multiple < WEAKEST_MULTIPLE:
                    raise
                multiple *= 0.5
        plant = drawn[-1].plant
    return drawn, plant


def responses_um(plant, changed, experiment, seed, recording):
    """Return the noise-free response of a plant, and the contribution of a change, (N,) each."""
    voltage_v, _ = records.commanded(experiment)
    surroundings = records.surroundings(experiment, seed)
    without_um, with_it_um = (
        response_um(stage, voltage_v, surroundings, records.clock_samples(experiment))[
            recording.playing]
        for stage in (plant, changed))
    return without_um, with_it_um - without_um


def _beyond_model_um(part, added_um):
    """Return the RMS of a signal with offset, initial creep and model parameters projected out."""
    rows = np.arange(part.begin, added_um.size)
    columns = np.column_stack([
        part.nuisance_regressors(rows), parameter_sensitivities(part, rows)])
    columns = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    residual = added_um[rows]
    residual = residual - columns @ np.linalg.lstsq(columns, residual, rcond=1e-10)[0]
    return float(np.sqrt(np.mean(residual**2)))
