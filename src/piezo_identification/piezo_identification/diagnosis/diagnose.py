# SPDX-License-Identifier: BSD-3-Clause
"""From a model and recordings to a verdict: what the model lacks, and how much better it gets."""

from dataclasses import dataclass, fields, replace

import numpy as np

from piezo_identification.diagnosis.contest import Contest
from piezo_identification.diagnosis.residual import dependences, spectrum, whiteness
from piezo_identification.diagnosis.selection import NOISE, NOTICEABLE, select
from piezo_identification.diagnosis.verdict import Verdict
from piezo_identification.prediction import CLEARLY_LESS, predict
from piezo_models.effects.outliers import FEWEST as FEWEST_OUTLIERS
from piezo_models.effects.outliers import Outliers
from piezo_models.measures import e_y_percent

EXPLAINED = 0.03
"""Part of the structure's power that may be left where effects explain it, a sixth of its size."""

GUESS = 0.5
"""Part of the structure's power that may be left before the effects found are mere guesses."""


@dataclass(frozen=True, eq=False)
class Diagnosis(Verdict):
    """A verdict with its evidence; the effects come with standard deviations, strongest first.

    Attributes
    ----------
    contest, selection :
        For the report.
    """

    contest: object
    selection: object


def diagnose(model, recordings, holdout=None, progress=None):
    """Find what a model lacks to explain recordings.

    Parameters
    ----------
    model : StageModel
    recordings : list of Recording
    holdout : Recording, optional
        On which the errors before and after are measured; by default they are measured on the
        stretches of the recordings that were not fitted.
    progress : callable, optional
        Called with (what is done, fraction).

    Returns
    -------
    Diagnosis

    Raises
    ------
    ValueError
        If there is no recording, or one cannot be used.
    """
    if not recordings:
        raise ValueError("there is no recording to diagnose: give one")
    contest, selection = _contested(model, recordings, progress)
    outliers = _outlier_entry(contest, selection.end)
    start, end = (contest.structure(trial) for trial in (selection.start, selection.end))
    allowed = max(NOISE**2, EXPLAINED * start)
    if end > allowed:
        verdict = "unexplained"
    elif selection.end.effects or outliers:
        verdict = "explained"
    else:
        verdict = "none"
    trial = selection.end
    if verdict == "unexplained" and end > GUESS * start:
        trial = selection.start
    effects = _effect_entries(contest, trial)
    if outliers:
        effects.append(outliers)
    effects.sort(key=lambda entry: -entry["error_reduction_percent"])
    extended = model
    if effects:
        extended = contest.extended_model(trial)
        if outliers:
            extended = replace(extended, effects=(*extended.effects, *_outlier_effect(contest)))
    before, after, where = _errors(model, extended, contest, trial, holdout)
    named = {entry["name"] for entry in effects}
    reasons = {name: why for name, why in selection.blind.items() if name not in named}
    for name, twin in selection.twins.items():
        if name not in named and twin in named:
            reasons[name] = f"the data does not tell it from {twin}"
    left = _description(contest, trial) if verdict == "unexplained" else ""
    return Diagnosis(
        verdict, effects, extended, before, after,
        float(np.median(contest.noise_um)), where, reasons, left, contest, selection,
    )


def _contested(model, recordings, progress):
    """The contest and its selection, with that past of the hysteresis that leaves less.

    A past that fits best beside a model that lacks something may be there only to make up for it.
    """
    contests = [Contest(model, recordings)]
    if any(part.past_v for part in contests[0].prepared):
        contests.append(Contest(model, recordings, past_v=()))
    contested = [
        (contest, select(contest, _part_of(progress, number, len(contests))))
        for number, contest in enumerate(contests)
    ]
    with_past, plain = contested[0], contested[-1]
    return with_past if _left_um(*with_past) < CLEARLY_LESS * _left_um(*plain) else plain


def _part_of(progress, number, count):
    """Progress of one of several works."""
    if progress is None:
        return None
    return lambda what, fraction: progress(what, (number + fraction) / count)


def _left_um(contest, selection):
    """RMS of what a selection leaves, noise and all."""
    left = selection.end.residual * contest.tolerance_um
    return float(np.sqrt(np.mean(left[contest.judge] ** 2)))


def _effect_entries(contest, trial):
    entries = []
    for number, effect in enumerate(trial.effects):
        others = (*trial.effects[:number], *trial.effects[number + 1 :])
        # Without it and everything else as it is, the error would be larger by what it contributes.
        added = contest.contribution(contest.trial(others), trial)
        left = np.sqrt(contest.held_out_square(trial))
        entry = {"name": effect.name, "parameters": effect.parameters(),
                 "error_reduction_percent": float(100.0 * (1.0 - left / np.hypot(left, added)))}
        entries.append(entry)
    _add_deviations(entries, trial)
    return entries


def _add_deviations(entries, trial):
    """Standard deviations of the fitted parameters."""
    if trial.covariance is None:
        return
    deviations = np.sqrt(np.maximum(np.diag(trial.covariance), 0.0))
    start = 0
    for entry, effect in zip(entries, trial.effects, strict=True):
        entry["standard_deviations"] = named = {}
        for field in fields(effect):
            value, scale = getattr(effect, field.name), field.metadata["scale"]
            if scale == "fixed":
                continue
            size = len(value) if isinstance(value, tuple) else 1
            spread = deviations[start : start + size]
            start += size
            if scale == "logarithm":
                spread = spread * np.atleast_1d(value)
            named[field.name] = (
                [float(number) for number in spread] if isinstance(value, tuple)
                else float(spread[0])
            )


def _outlier_effect(contest):
    for index in range(len(contest.prepared)):
        yield from Outliers.starts(contest.evidence(index))[:1]
        return


def _outlier_entry(contest, trial):
    """Of the outliers, if there are more than chance makes and they are worth a name."""
    parts = list(enumerate(contest.prepared))
    wrong = np.concatenate([contest.wrong[index][part.begin :] for index, part in parts])
    residual = np.concatenate([
        contest.residual_um(index, trial.effects)[part.begin :] for index, part in parts
    ])
    if wrong.sum() < FEWEST_OUTLIERS:
        return None
    if np.sqrt(np.mean(np.where(wrong, residual, 0.0) ** 2)) < NOTICEABLE * np.median(
            contest.tolerance_um):
        return None
    clean, all_rms = np.std(residual[~wrong]), np.std(residual)
    return {
        "name": Outliers.name,
        "parameters": {"share": float(wrong.mean()),
                       "size_um": float(np.sqrt(np.mean(residual[wrong] ** 2)))},
        "error_reduction_percent": float(100.0 * (1.0 - clean / all_rms)),
    }


def _errors(model, extended, contest, trial, holdout):
    if holdout is not None:
        errors = []
        for tried in (model, extended):
            prediction = predict(tried, holdout)
            left = prediction.measured_um - prediction.simulated_um
            errors.append({"rms_um": float(np.sqrt(np.mean(left**2))),
                           "e_y_percent": float(prediction.e_y_percent())})
        return *errors, {"source": str(holdout.path), "samples": int(left.size)}
    judges = ~contest.fitted, contest.judge
    judge = contest.judge
    measured = np.concatenate([
        part.measured_um[rows] for part, rows in zip(contest.prepared, contest.rows, strict=True)
    ])
    errors = []
    untuned = _untuned_residual(contest)
    for residual, judge in zip(
        (untuned, untuned if extended is model else trial.residual), judges, strict=True
    ):
        left = (residual * contest.tolerance_um)[judge]
        errors.append({"rms_um": float(np.sqrt(np.mean(left**2))),
                       "e_y_percent": e_y_percent(measured[judge], measured[judge] - left)})
    return *errors, {"source": "stretches of the recordings that were not fitted",
                     "samples": int(np.count_nonzero(judge))}


def _untuned_residual(contest):
    """Of the model as it was given, with offset and initial creep free."""
    difference = contest.rows_of(())
    free = contest.weighted[:, : contest.free_count]
    fit = contest.fit
    return difference - free @ np.linalg.lstsq(free[fit], difference[fit], rcond=1e-12)[0]


def _description(contest, trial):
    """Where, when, how large and at which frequencies something is left."""
    sentences = []
    for index, part in enumerate(contest.prepared):
        residual = contest.residual_um(index, trial.effects)[part.begin :]
        frequency_hz, density = spectrum(residual, part.sample_period_s)
        power = np.cumsum(density[1:])
        low, high = frequency_hz[1:][np.searchsorted(power, [0.1 * power[-1], 0.9 * power[-1]])]
        peak_hz = frequency_hz[1:][np.argmax(density[1:])]
        found = dependences(residual, part.simulate(trial.effects)[part.begin :],
                            part.voltage_v[part.begin :], part.time_s[part.begin :])
        strongest = max(found, key=lambda dependence: dependence.share)
        worst = part.begin + int(np.argmax(np.abs(residual)))
        text = (
            f"{part.path}: {1e3 * np.sqrt(np.mean(residual**2)):.3g} nm RMS beside "
            f"{1e3 * contest.noise_um[index]:.3g} nm of noise; largest at "
            f"{part.time_s[worst]:.4g} s, {part.voltage_v[worst]:.4g} V; most of it from "
            f"{low:.3g} to {high:.3g} Hz, strongest at {peak_hz:.4g} Hz"
        )
        if strongest.share > 0.05:
            text += (f"; {100 * strongest.share:.0f} % of its power goes with "
                     f"{strongest.quantity.split(' / ')[0]}")
        if whiteness(residual).passed:
            text += "; neighbouring samples are not alike"
        sentences.append(text + ".")
    return " ".join(sentences)
