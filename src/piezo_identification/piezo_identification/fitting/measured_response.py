# SPDX-License-Identifier: BSD-3-Clause
"""A measured frequency response as a part of the data of a joint fit."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from piezo_common.arrays import BoolArray, ComplexArray, FloatArray
from piezo_identification.fitting.dataset import SPLIT
from piezo_identification.fitting.regression import SETTINGS as FIT
from piezo_models.cascade import StageModel

HIGHEST_MODE = 30.0
"""Highest frequency of a mode in a fit, relative to the highest measured one."""

MOST_LOSS_RAD = 0.3
"""Largest lag of small sines due to hysteresis; a full loop whose width is a third of its travel
has this angle."""


@dataclass(frozen=True, eq=False)
class MeasuredResponse:
    """A response without hold, whose small-signal gain no other recording shows."""

    frequency_hz: FloatArray = field(repr=False)

    weighted: ComplexArray = field(repr=False)
    """Gain over its noise at each frequency, relative to its mean noise, (N,)."""
    weight: FloatArray = field(repr=False)
    noise: float
    """Standard deviation of the real and of the imaginary part of the weighted gain."""
    independent: float
    """Number of independent errors that count, at most that of a recording."""

    @property
    def accuracy(self) -> float:
        """Return the accuracy of a good model, in the unit of the weighted gain."""
        return float(FIT.model_tolerance * np.sqrt(np.mean(np.abs(self.weighted) ** 2)))

    @property
    def sample_period_s(self) -> float:
        """Return the longest period of samples that show the same frequencies."""
        return float(0.5 / self.frequency_hz[-1])

    @property
    def highest_mode_rad_per_s(self) -> float:
        """Return the highest frequency of a mode that the response may show by its flank."""
        return float(HIGHEST_MODE * 2.0 * np.pi * self.frequency_hz[-1])

    @property
    def stretch(self) -> NDArray[np.intp]:
        """Return the number of the stretch of each value of `residual`, (2 N,)."""
        count = self.frequency_hz.size
        return np.repeat(
            np.arange(count) * SPLIT.stretches // max(count, SPLIT.stretches), 2)

    @property
    def for_estimation(self) -> BoolArray:
        """Return which values of `residual` may be fitted; the others are the validation set."""
        return np.asarray(self.stretch % SPLIT.held_out != SPLIT.held_out // 2)

    def residual(self, model: StageModel) -> FloatArray:
        """Return real and imaginary parts of the weighted error with the best gain, (2 N,)."""
        modelled = self.weight * model.small_signal_response(self.frequency_hz)
        return np.asarray(
            self.weighted - best_gain(modelled, self.weighted) * modelled).view(float)


def best_gain(modelled: ComplexArray, measured: ComplexArray) -> complex:
    """Return the factor by which the response of the linear part of a model fits one measured best.

    It is that of small signals, which no other recording shows. Behind hysteresis, which the model
    need not know, it lags by the same angle at all frequencies.
    """
    along = np.vdot(modelled, measured)
    angle = np.angle(along if along.real > 0.0 else -along)
    turn = np.exp(1j * np.clip(angle, -MOST_LOSS_RAD, 0.0))
    return complex((along * turn.conj()).real / np.vdot(modelled, modelled).real * turn)
