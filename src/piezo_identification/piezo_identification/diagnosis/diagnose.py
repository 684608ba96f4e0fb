# SPDX-License-Identifier: BSD-3-Clause
"""From a model and recordings to a verdict: what the model lacks, and how much better it gets."""

from dataclasses import dataclass, fields, replace

import numpy as np

from piezo_identification.diagnosis.comparison import Contest
from piezo_identification.diagnosis.held_out import HeldOut
from piezo_identification.diagnosis.outliers import found_outliers, left_out
from piezo_identification.diagnosis.residual import dependences, spectrum, whiteness
from piezo_identification.diagnosis.selection import NOISE, select
from piezo_identification.diagnosis.verdict import Verdict
from piezo_identification.prediction import PastSearchSettings, conditioned

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
    given = [*recordings, *([] if holdout is None else [holdout])]
    signed, changed = zip(*(conditioned(model, recording) for recording in given), strict=True)
    if holdout is not None:
        *signed, holdout = signed
    contest, selection = _contested(model, signed, progress)
    held_out = HeldOut(contest, holdout)
    trial, refused = held_out.kept(selection.end)
    start, end = contest.structure(selection.start), contest.structure(trial)
    allowed = max(NOISE**2, EXPLAINED * start)
    if end > allowed and end > GUESS * start:
        trial = selection.start
    effects = _effect_entries(contest, trial)
    outliers = found_outliers(contest)
    if outliers:
        effects.append(outliers.entry(contest, trial))
    if end > allowed:
        verdict = "unexplained"
    else:
        verdict = "explained" if effects else "none"
    effects.sort(key=lambda entry: -entry["error_reduction_percent"])
    extended = contest.extended_model(trial) if trial.effects else model
    before, after, where = held_out.errors(trial)
    if outliers:
        extended = replace(extended, effects=(*extended.effects, outliers.effect(contest)))
    named = {entry["name"] for entry in effects}
    reasons = {name: why for name, why in (selection.blind | refused).items() if name not in named}
    for name, twin in selection.twins.items():
        if name not in named and twin in named:
            reasons[name] = f"the data does not tell it from {twin}"
    left = _description(contest, trial) if verdict == "unexplained" else ""
    return Diagnosis(
        verdict, effects, extended, before, after, float(np.median(contest.noise_um)), where,
        reasons, left,
        [str(recording.path) for recording, is_reversed in zip(given, changed, strict=True)
         if is_reversed],
        [*left_out(contest), *held_out.left_out()], contest, selection,
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
    most_um = PastSearchSettings.largest_error_ratio * _left_um(*plain)
    return with_past if _left_um(*with_past) < most_um else plain


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


def _description(contest, trial):
    """Where, when, how large and at which frequencies something is left."""
    sentences = []
    for index, part in enumerate(contest.prepared):
        residual = contest.residual_um(index, trial.effects)
        residual = np.where(contest.wrong[index], 0.0, residual)[part.begin :]
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
