# SPDX-License-Identifier: BSD-3-Clause
"""Weights of the feedback design: the requirements on the loop over frequency."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from importlib.resources import files
from pathlib import Path
from typing import Any, TypeVar

import control
from scipy.signal import zpk2ss

from piezo_common.schema import SchemaError, load_document, parsed
from piezo_controller.feedback.synthesis.design_choices import DEFAULT_WEIGHTS, DISTURBANCE_HZ
from piezo_controller.feedback.synthesis.weights_document import WeightEntry, WeightsDocument

BUILT_IN = {DEFAULT_WEIGHTS: files("piezo_controller") / "weights.yaml",
            "thesis": files("piezo_controller") / "weights_thesis.yaml"}


Root = TypeVar("Root", float, complex)


class WeightsError(ValueError):
    """A weights file that does not describe a design."""


@dataclass(frozen=True)
class Weight:
    """The weight ``gain * prod(z - zero) / prod(z - pole)`` at the tick rate."""

    gain: float
    zeros: tuple[float, ...] = ()
    poles: tuple[float, ...] = ()

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
        zeros = (*map(moved, self.zeros), *(missing,) * (len(self.poles) - len(self.zeros)))
        poles = tuple(map(moved, self.poles))
        # The magnitude is preserved at a point without real roots.
        gain = self.gain * abs(_product(1j, self.zeros, self.poles)
                               / _product(moved(1j), zeros, poles))
        return Weight(gain, zeros, poles)


@dataclass(frozen=True)
class DesignWeights:
    """Weights of the generalised plant (thesis fig. 5.5)."""

    sample_period_s: float
    """Period of the tick (s)."""
    performance: Weight
    control: Weight
    reference: Weight
    noise: Weight
    disturbance: Weight
    """``w1``, ``w2``, ``w_r``, ``w_n``, ``w_d``; those of the thesis are (5.15) and (5.16)."""
    feedforward_error: float
    """``w_delta`` of (5.12)."""
    hysteresis_uncertainty: float
    """``w_u``: the hysteresis' gain lies within ``1 +- w_u`` of its nominal value."""

    def at_tick(self, sample_period_s: float) -> "DesignWeights":
        """Return weights with the same requirements at another tick."""
        names = ("performance", "control", "reference", "noise", "disturbance")
        stretched = self._stretched(names, sample_period_s / self.sample_period_s)
        return replace(stretched, sample_period_s=sample_period_s)

    def for_disturbances(self, bandwidth_hz: float) -> "DesignWeights":
        """Return weights for another bandwidth of the disturbances; ``w1`` and ``w_d`` move."""
        return self._stretched(("performance", "disturbance"), bandwidth_hz / DISTURBANCE_HZ)

    def _stretched(self, names: Sequence[str], factor: float) -> "DesignWeights":
        """Return weights, some of them with frequencies multiplied by a factor."""
        return replace(self, **{name: getattr(self, name).stretched(factor) for name in names})

    def as_dict(self) -> dict[str, Any]:
        """Return plain numbers and lists, in the layout of the weights file."""
        return {name: {key: list(item) if isinstance(item, tuple) else item
                       for key, item in value.items()} if isinstance(value, dict) else value
                for name, value in asdict(self).items()}


def load_weights(path: str | Path = DEFAULT_WEIGHTS) -> DesignWeights:
    """Read a weights file.

    Parameters
    ----------
    path : path-like
        YAML file, or the name of built-in weights: ``default`` or ``thesis``.

    Raises
    ------
    WeightsError
        If the file is not valid; the message names the file, the entry and what it should be.
    """
    built_in = BUILT_IN.get(str(path))
    try:
        document = (load_document(WeightsDocument, path) if built_in is None
                    else parsed(WeightsDocument, built_in.read_text(encoding="utf-8")))
    except SchemaError as error:
        raise WeightsError(f"the weights file {path}: {error}") from None
    return DesignWeights(
        document.sample_period_s, _weight(document.performance), _weight(document.control),
        _weight(document.reference), _weight(document.noise), _weight(document.disturbance),
        document.feedforward_error, document.hysteresis_uncertainty)


def _weight(entry: WeightEntry) -> Weight:
    return Weight(entry.gain, tuple(entry.zeros), tuple(entry.poles))


def _product(point: complex, zeros: Sequence[float], poles: Sequence[float]) -> complex:
    return math.prod(point - zero for zero in zeros) / math.prod(point - pole for pole in poles)
