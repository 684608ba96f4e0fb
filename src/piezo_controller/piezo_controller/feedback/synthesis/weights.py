# SPDX-License-Identifier: BSD-3-Clause
"""Weights of the feedback design: the requirements on the loop over frequency."""

import math
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import ClassVar, TypeVar

import control
from pydantic import model_validator
from scipy.signal import zpk2ss

from piezo_common.schema import (
    Document,
    Number,
    Numbers,
    Part,
    SchemaError,
    entry,
    load_document,
    parsed,
    violation,
)
from piezo_controller.feedback.synthesis.design_choices import DEFAULT_WEIGHTS, DISTURBANCE_HZ

BUILT_IN = {DEFAULT_WEIGHTS: files("piezo_controller") / "weights.yaml",
            "thesis": files("piezo_controller") / "weights_thesis.yaml"}


Root = TypeVar("Root", float, complex)


class WeightsError(ValueError):
    """A weights file that does not describe a design."""


class Weight(Part):
    """The weight ``gain * prod(z - zero) / prod(z - pole)`` at the tick rate."""

    gain: Number = entry("Gain.", above=0.0)
    zeros: Numbers = entry("Zeros in the plane of z, no more than poles.")
    poles: Numbers = entry("Poles in the plane of z, each inside the unit circle.")

    @model_validator(mode="after")
    def _check_proper_and_stable(self) -> "Weight":
        if len(self.zeros) > len(self.poles):
            raise violation("has more zeros than poles", "give as many poles")
        for i, pole in enumerate(self.poles):
            if abs(pole) >= 1:
                raise violation("lies on or outside the unit circle, for which no controller "
                                "exists", "use 0.9995 for integral action", f"poles[{i}]")
        return self

    def state_space(self, sample_period_s: float) -> control.StateSpace:
        """Return the weight as a discrete ``control.StateSpace``."""
        if not self.poles:
            return control.ss([], [], [], [[self.gain]], sample_period_s)
        return control.ss(*zpk2ss(self.zeros, self.poles, self.gain), sample_period_s)

    def stretched(self, factor: float) -> "Weight":
        """Multiply the frequencies of the weight by `factor`, under Tustin's rule."""
        if factor == 1:
            return self

        def moved(z: Root) -> Root:
            # -1 corresponds to infinite frequency, and does not move.
            return ((z + 1) + factor * (z - 1)) / ((z + 1) - factor * (z - 1))

        # Zeros at infinity, as many as there are fewer zeros than poles, move to this point.
        missing = (1 + factor) / (1 - factor)
        zeros = [*map(moved, self.zeros), *[missing] * (len(self.poles) - len(self.zeros))]
        poles = [*map(moved, self.poles)]
        # The magnitude is preserved at a point without real roots.
        gain = self.gain * abs(_product(1j, self.zeros, self.poles)
                               / _product(moved(1j), zeros, poles))
        return Weight(gain=gain, zeros=zeros, poles=poles)


class DesignWeights(Document):
    """The weights file: the requirements on the feedback loop over frequency (thesis fig. 5.5)."""

    TITLE: ClassVar[str] = "weights file"
    SYNTAX: ClassVar[str] = "yaml"
    RENEW: ClassVar[str] = "add it, as in the weights that come with the package"

    sample_period_s: Number = entry("Tick that the weights are written for.", unit="s", above=0.0)
    performance: Weight = entry("Weight w1 of the tracking error, (5.15).")
    control: Weight = entry("Weight w2 of the control voltage, (5.15).")
    reference: Weight = entry("Weight w_r of the reference, (5.16).")
    noise: Weight = entry("Weight w_n of the sensor's noise, (5.16).")
    disturbance: Weight = entry("Weight w_d of the disturbance, (5.16).")
    feedforward_error: Number = entry("Error w_delta of the feedforward, (5.12).", above=0.0)
    hysteresis_uncertainty: Number = entry(
        "The hysteresis' gain lies within 1 +- w_u of its nominal value.", above=0.0)

    def at_tick(self, sample_period_s: float) -> "DesignWeights":
        """Return weights with the same requirements at another tick."""
        names = ("performance", "control", "reference", "noise", "disturbance")
        stretched = self._stretched(names, sample_period_s / self.sample_period_s)
        return stretched.model_copy(update={"sample_period_s": sample_period_s})

    def for_disturbances(self, bandwidth_hz: float) -> "DesignWeights":
        """Return weights for another bandwidth of the disturbances; ``w1`` and ``w_d`` move."""
        return self._stretched(("performance", "disturbance"), bandwidth_hz / DISTURBANCE_HZ)

    def _stretched(self, names: Sequence[str], factor: float) -> "DesignWeights":
        """Return weights, some of them with frequencies multiplied by a factor."""
        return self.model_copy(update={
            name: getattr(self, name).stretched(factor) for name in names})


def load_weights(path: str | Path = DEFAULT_WEIGHTS) -> DesignWeights:
    """Read a weights file (YAML), or built-in weights by their name, ``default`` or ``thesis``.

    Raises `WeightsError` if the file is not valid; the message names the file, the entry and what
    it should be.
    """
    built_in = BUILT_IN.get(str(path))
    try:
        return (load_document(DesignWeights, path) if built_in is None
                else parsed(DesignWeights, built_in.read_text(encoding="utf-8")))
    except SchemaError as error:
        raise WeightsError(f"the weights file {path}: {error}") from None


def _product(point: complex, zeros: Sequence[float], poles: Sequence[float]) -> complex:
    return math.prod(point - zero for zero in zeros) / math.prod(point - pole for pole in poles)
