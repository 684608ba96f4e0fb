# SPDX-License-Identifier: BSD-3-Clause
"""The error before and after on the same held-out samples, and the effects that it refuses."""

from functools import cached_property

import numpy as np

from piezo_identification.conditioning.outlier_samples import outlier_text
from piezo_identification.prediction import predict
from piezo_models.measures import e_y_percent


class HeldOut:
    """Samples that were not fitted: of another recording, or stretches of those diagnosed.

    Parameters
    ----------
    contest : Contest
    holdout : Recording or None
        With the sign of the model, and its outliers marked.
    """

    def __init__(self, contest, holdout=None):
        self.contest, self.holdout = contest, holdout

    @property
    def source(self):
        """Where they are from."""
        if self.holdout is None:
            return "stretches of the recordings that were not fitted"
        return str(self.holdout.path)

    def errors(self, trial):
        """Errors of the model as given, and extended by a trial, on the same samples.

        Parameters
        ----------
        trial : Trial or None
            None for the model as given.

        Returns
        -------
        before, after : dict of str to float
            `rms_um` and `e_y_percent`.
        where : dict
            `source`, and `samples` that were counted.
        """
        given, extended = self._given, self._of(trial)
        good = given.good & extended.good
        before, after = given.errors(good), extended.errors(good)
        return before, after, {"source": self.source, "samples": int(np.count_nonzero(good))}

    def kept(self, trial):
        """A trial without the effects that no stage can have, or that make the error larger.

        Parameters
        ----------
        trial : Trial

        Returns
        -------
        trial : Trial
        refused : dict of str to str
            Names of the effects that were taken out, and why.
        """
        trial, refused = self._possible(trial)
        # Among the stretches of the recordings, each effect was chosen by just this.
        while self.holdout is not None and len(trial.effects) > 1:
            errors_um = [(*self._rms_um(other, trial), number, other) for number, other in (
                (number, self._without(trial, number)) for number in range(len(trial.effects)))]
            without_um, with_um, number, other = min(errors_um, key=lambda error: error[0])
            if without_um > with_um:
                break
            refused[trial.effects[number].name] = self._worse(without_um, with_um)
            trial = other
        if trial.effects and not self.improves(trial):
            without_um, with_um = self._rms_um(None, trial)
            refused |= {effect.name: self._worse(without_um, with_um)
                        for effect in trial.effects}
            trial = self.contest.trial(())
        return trial, refused

    def improves(self, trial):
        """Whether the error of a trial is smaller than that of the model as given."""
        given_um, trial_um = self._rms_um(None, trial)
        return trial_um < given_um

    def _possible(self, trial):
        """A trial without the effects that no stage can have, and why those were taken out."""
        refused = {}
        while impossible := self.contest.impossible(trial):
            number = next(number for number, effect in enumerate(trial.effects)
                          if effect.name in impossible)
            name = trial.effects[number].name
            refused[name] = impossible[name]
            trial = self._without(trial, number)
        return trial, refused

    def _worse(self, without_um, with_um):
        return (f"with it the error on {self.source} rises from {1e3 * without_um:.3g} to "
                f"{1e3 * with_um:.3g} nm RMS")

    def left_out(self):
        """What people are told of outliers of the other recording: sentences."""
        if self.holdout is None:
            return []
        text = outlier_text(self.source, ~self._given.good, self._given.time_s)
        return [text] if text else []

    def _without(self, trial, number):
        """The trial without one of its effects, the rest fitted anew."""
        others = (*trial.effects[:number], *trial.effects[number + 1 :])
        return self.contest.fit_effects(others) if others else self.contest.trial(())

    def _rms_um(self, *trials):
        """RMS errors of some trials on the samples that are good beside all of them."""
        samples = [self._of(trial) for trial in trials]
        good = np.all([each.good for each in samples], axis=0)
        return tuple(each.errors(good)["rms_um"] for each in samples)

    @cached_property
    def _given(self):
        """Samples of the model as given."""
        contest = self.contest
        if self.holdout is not None:
            return _predicted(contest.model, self.holdout)
        difference = contest.rows_of(())
        free = contest.weighted[:, : contest.free_count]
        fit = contest.fit
        left = difference - free @ np.linalg.lstsq(free[fit], difference[fit], rcond=1e-12)[0]
        return self._rows(left)

    def _of(self, trial):
        """Samples of the model extended by a trial, or as given without one."""
        if trial is None:
            return self._given
        if self.holdout is not None:
            return _predicted(self.contest.extended_model(trial), self.holdout)
        return self._rows(trial.residual)

    def _rows(self, left):
        """Samples of what is left at the rows of the contest, over the tolerance."""
        contest = self.contest
        measured_um = np.concatenate([
            part.measured_um[rows]
            for part, rows in zip(contest.prepared, contest.rows, strict=True)
        ])
        time_s = np.concatenate([
            part.time_s[rows] for part, rows in zip(contest.prepared, contest.rows, strict=True)
        ])
        return _Samples(time_s, measured_um, left * contest.tolerance_um, contest.judge)


class _Samples:
    """Measured displacement, what is left of it, and which of it counts."""

    def __init__(self, time_s, measured_um, left_um, good):
        self.time_s, self.measured_um, self.left_um, self.good = time_s, measured_um, left_um, good

    def errors(self, good):
        """Errors of some samples."""
        measured_um, left_um = self.measured_um[good], self.left_um[good]
        return {"rms_um": float(np.sqrt(np.mean(left_um**2))),
                "e_y_percent": float(e_y_percent(measured_um, measured_um - left_um))}


def _predicted(model, recording):
    """Samples of a model's prediction, at all samples of a recording."""
    prediction = predict(model, recording)
    measured_um = np.zeros(recording.time_s.size)
    left_um, good = measured_um.copy(), np.zeros(measured_um.size, dtype=bool)
    # A model that settles later is judged from then on.
    at = np.searchsorted(recording.sample_index, prediction.sample_index)
    measured_um[at] = prediction.measured_um
    left_um[at] = prediction.measured_um - prediction.simulated_um
    good[at] = prediction.good
    return _Samples(recording.time_s, measured_um, left_um, good)
