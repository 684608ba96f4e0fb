# SPDX-License-Identifier: BSD-3-Clause
"""Conversion of the feedback law to a message."""

import array
import math
from typing import Any

import numpy as np
import numpy.typing as npt
import piezo_interfaces.msg as messages


def message_of(law: Any) -> messages.FeedbackLaw:
    """Return the message of a law."""
    message = messages.FeedbackLaw(
        tick=_block(law.tick), observer=_floats(law.observer), delay_ticks=law.delay_ticks,
        sample=_block(law.sample), max_feedback_v=float(law.max_feedback_v),
        max_error_um=float(law.max_error_um) if math.isfinite(law.max_error_um) else 0.0,
        once_expected_um=_floats(law.once_um), period_expected_um=_floats(law.period_um),
        start_sample=law.start_sample, fade_samples=law.fade_samples,
        model=_block(law.plant.linear),
        model_gains_um_per_v=_floats(law.plant.gains_um_per_v), axes=list(law.axes))
    if law.inverse is not None:
        hysteresis = law.inverse.hysteresis
        message.inverse_gain_um_per_v = float(law.inverse.gain_um_per_v)
        message.hold_inverse = law.inverse.held
        message.hysteresis = messages.PreisachHysteresis(
            voltage_min_v=hysteresis.voltage_min_v, voltage_max_v=hysteresis.voltage_max_v,
            offset_um=hysteresis.offset_um,
            density_um_per_v2=_floats(hysteresis.density_um_per_v2),
            reversible_um_per_v=_floats(hysteresis.reversible_um_per_v))
    return message


def _block(block: Any) -> messages.StateSpace:
    message = messages.StateSpace(a=_floats(block.a), b=_floats(block.b), c=_floats(block.c))
    if np.ndim(block.d):
        message.outputs, message.inputs = np.shape(block.d)
        message.direct = _floats(block.d)
    else:
        message.d = float(block.d)
    return message


def _floats(values: npt.ArrayLike) -> array.array:
    return array.array("d", np.ascontiguousarray(values, dtype=float).tobytes())
