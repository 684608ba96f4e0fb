# SPDX-License-Identifier: BSD-3-Clause
"""Extended models that an operator has accepted in place of the models they were made from.

Feedforward and feedback of a run come from the same model. Both change together, between two runs
or between two ticks of one run.
"""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from piezo_models.cascade import StageModel
from piezo_models.model_file import load_model


@dataclass(frozen=True)
class ModelText:
    """The text of a model file."""

    path: str
    text: str

    @property
    def sha256(self) -> str:
        """Return the hash of the text."""
        return hashlib.sha256(self.text.encode()).hexdigest()


MOST_FACTOR = 2.0
"""Largest factor between gains or modes of one stage; a larger one means another stage."""

CheckFeedback = Callable[[StageModel, str, StageModel], None]
"""Raises ValueError if the feedback for a model (given its hash) is unstable with it or another."""


def gross_difference(present: StageModel, following: StageModel) -> str:
    """Return a property in which models differ by more than `MOST_FACTOR`; empty if there is none.

    The present model is the one that runs use, and that has described the stage correctly.
    """
    before, after = ([("gain", "um/V", _gain_um_per_v(model)), *(
        ("mode", "Hz", frequency / (2.0 * np.pi))
        for frequency in sorted(model.dynamics.mode_frequencies_rad_per_s))]
        for model in (present, following))
    for (what, unit, was), (_, _, now) in zip(before, after, strict=False):
        if not was / MOST_FACTOR <= now <= was * MOST_FACTOR:
            return f"with a {what} of {now:.4g} {unit} where that has {was:.4g} {unit}"
    return ""


def _gain_um_per_v(model: StageModel) -> float:
    """Return the mean gain of the model over its range at rest."""
    return float(model.hysteresis.mean_gain_um_per_v * abs(model.linear()(0.0)))


class AcceptedModels:
    """Which model replaces which; models are identified by the hash of their text."""

    def __init__(self) -> None:
        self._extended: dict[str, ModelText] = {}

    def accept(self, model: ModelText, extended: ModelText, check: CheckFeedback,
               go_over: Callable[[ModelText], str] = lambda _: "") -> str:
        """Use an extended model in place of a model from now on; return what `go_over` returned.

        `check` designs the feedback for the extended model, and raises ValueError if it is
        unstable. `go_over` switches the run in progress to the model; it returns from when on it is
        used, and may raise. Raises ValueError if a file cannot be used, the models differ grossly,
        the feedback is unstable, or the run in progress cannot switch; nothing changes then.
        """
        present, following = (load_model(one.path).model for one in (model, extended))
        before, after = present.hysteresis, following.hysteresis
        ranges = [(one.voltage_min_v, one.voltage_max_v) for one in (before, after)]
        if ranges[0] != ranges[1] or (
                before.density_um_per_v2.shape != after.density_um_per_v2.shape):
            (low_v, high_v), (lower_v, higher_v) = ranges
            raise ValueError(
                f"{extended.path} has another hysteresis, from {lower_v:g} to {higher_v:g} V in "
                f"{len(after.density_um_per_v2)} cells where {model.path} has {low_v:g} to "
                f"{high_v:g} V in {len(before.density_um_per_v2)}: give a model that extends it")
        if difference := gross_difference(present, following):
            raise ValueError(f"{extended.path} is of another stage than {model.path}, "
                             f"{difference}: identify the stage again")
        check(following, extended.sha256, present)
        when = go_over(extended)
        self._extended[model.sha256] = extended
        return when

    def withdraw(self, model: ModelText) -> None:
        """Use a model itself again."""
        self._extended.pop(model.sha256, None)

    def in_place_of(self, model: ModelText, read: Callable[[str], str]) -> ModelText:
        """Return the model to use for a run that names a model; `read` returns the text of a file.

        Raises ValueError if the extended model has been changed since it was accepted.
        """
        extended = self._extended.get(model.sha256)
        if extended is None:
            return model
        if read(extended.path) != extended.text:
            raise ValueError(f"{extended.path} has been changed since it was accepted in place of "
                             f"{model.path}: accept it again, or withdraw it")
        return extended
