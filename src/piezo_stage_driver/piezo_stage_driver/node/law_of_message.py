# SPDX-License-Identifier: BSD-3-Clause
"""Conversion of a message to the feedback law."""

import math
from collections.abc import Sequence

import numpy as np
from piezo_interfaces.msg import FeedbackLaw as FeedbackLawMessage
from piezo_interfaces.msg import PreisachHysteresis, StateSpace

from piezo_common.arrays import FloatArray
from piezo_models.feedback_law.feedback_law import (
    DeclaredPlant,
    FeedbackLaw,
    FeedbackLawError,
    InverseHysteresis,
    LinearBlock,
)
from piezo_models.hysteresis.preisach import PreisachModel


def law_of(message: FeedbackLawMessage) -> FeedbackLaw:
    """Return the law of a message; raise ValueError if its parts do not match."""
    inverse, axes = None, len(message.axes)
    if message.inverse_gain_um_per_v:
        inverse = InverseHysteresis(
            _hysteresis(message.hysteresis), message.inverse_gain_um_per_v, message.hold_inverse)
    return FeedbackLaw(
        tick=_block(message.tick), observer=_by_axis(message.observer, axes),
        max_feedback_v=message.max_feedback_v, once_um=_by_axis(message.once_expected_um, axes),
        period_um=_by_axis(message.period_expected_um, axes),
        plant=DeclaredPlant(_block(message.model), _by_axis(message.model_gains_um_per_v, axes)),
        start_sample=message.start_sample, delay_ticks=message.delay_ticks,
        sample=_block(message.sample), inverse=inverse,
        max_error_um=message.max_error_um or math.inf, fade_samples=message.fade_samples,
        axes=tuple(message.axes))


def _block(message: StateSpace) -> LinearBlock:
    if message.inputs != message.outputs:
        raise FeedbackLawError(f"a linear block has {message.inputs} inputs and {message.outputs} "
                               "outputs: give one of each for each axis")
    return LinearBlock.of(message.a, message.b, message.c, message.direct or [message.d],
                          message.inputs)


def _by_axis(values: Sequence[float], axes: int) -> FloatArray:
    """Return numbers as an array, with a column for each axis if there are several."""
    if len(values) % max(axes, 1):
        raise FeedbackLawError(f"an array of the law has {len(values)} elements for {axes} axes: "
                               "give as many of each")
    return np.reshape(values, (-1, axes) if axes else -1)


def _hysteresis(message: PreisachHysteresis) -> PreisachModel:
    levels, density = len(message.reversible_um_per_v), np.array(message.density_um_per_v2)
    if density.size != levels**2 or not levels:
        raise FeedbackLawError(f"hysteresis has {density.size} densities for {levels} levels: give "
                               "a square matrix, and a reversible part for each level")
    return PreisachModel(message.voltage_min_v, message.voltage_max_v,
                         density.reshape(levels, levels), message.offset_um,
                         np.array(message.reversible_um_per_v))
