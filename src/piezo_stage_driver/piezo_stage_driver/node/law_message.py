# SPDX-License-Identifier: BSD-3-Clause
"""Conversion of a message to the feedback law."""

import math

import numpy as np
from piezo_interfaces.msg import FeedbackLaw as FeedbackLawMessage
from piezo_interfaces.msg import PreisachHysteresis, StateSpace

from piezo_models.feedback_law.feedback_law import (
    DeclaredPlant,
    FeedbackLaw,
    FeedbackLawError,
    InverseHysteresis,
    LinearBlock,
)
from piezo_models.hysteresis.preisach import PreisachModel


def law_of(message: FeedbackLawMessage) -> FeedbackLaw:
    """Return the law of a message.

    Raises
    ------
    FeedbackLawError, ValueError
        If the parts do not match.
    """
    inverse = None
    if message.inverse_gain_um_per_v:
        inverse = InverseHysteresis(
            _hysteresis(message.hysteresis), message.inverse_gain_um_per_v, message.hold_inverse)
    return FeedbackLaw(
        tick=_block(message.tick), observer=np.array(message.observer),
        max_feedback_v=message.max_feedback_v, once_um=np.array(message.once_expected_um),
        period_um=np.array(message.period_expected_um),
        plant=DeclaredPlant(_block(message.model), np.array(message.model_gains_um_per_v)),
        start_sample=message.start_sample, delay_ticks=message.delay_ticks,
        sample=_block(message.sample), inverse=inverse,
        max_error_um=message.max_error_um or math.inf, fade_samples=message.fade_samples)


def _block(message: StateSpace) -> LinearBlock:
    return LinearBlock.of(message.a, message.b, message.c, [message.d])


def _hysteresis(message: PreisachHysteresis) -> PreisachModel:
    levels, density = len(message.reversible_um_per_v), np.array(message.density_um_per_v2)
    if density.size != levels**2 or not levels:
        raise FeedbackLawError(f"hysteresis has {density.size} densities for {levels} levels: give "
                               "a square matrix, and a reversible part for each level")
    return PreisachModel(message.voltage_min_v, message.voltage_max_v,
                         density.reshape(levels, levels), message.offset_um,
                         np.array(message.reversible_um_per_v))
