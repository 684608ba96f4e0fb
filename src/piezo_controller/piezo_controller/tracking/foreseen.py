# SPDX-License-Identifier: BSD-3-Clause
"""What a mode without an inverse leaves of a reference, as its linear loop foresees it."""

from collections.abc import Callable

import numpy as np

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_controller.references.kind import Reference, Watch
from piezo_controller.tracking.tracking_modes import StageClock, plan_mode
from piezo_models.cascade import StageModel
from piezo_models.linear.dynamics import zoh_response

SHARE_AT_REST = 0.9
"""An rms error of this part of that at rest leaves four fifths of the power: no following."""

# What a harmonic contributes below this part of the largest is less than a millionth of the power.
NEGLIGIBLE_HARMONIC = 1e-3

Sensitivity = Callable[[FloatArray], ComplexArray]
"""Returns, for frequencies (Hz), the part of the reference that is left as an error."""


def open_loop_sensitivity(model: StageModel, sample_period_s: float) -> Sensitivity:
    """Return what the linear part of a model leaves where nothing inverts it."""
    linear = model.linear()
    return lambda frequency_hz: 1.0 - zoh_response(linear, frequency_hz, sample_period_s)


def foreseen_share(period_um: FloatArray, sample_period_s: float,
                   sensitivity: Sensitivity) -> float:
    """Foresee the rms error, as a part of that of a stage at rest at the reference's mean.

    Parameters
    ----------
    period_um : ndarray, shape (m,)
        One period of the reference.

    Returns
    -------
    float
        0 for a reference that stands still.
    """
    harmonics = np.abs(np.fft.rfft(period_um - period_um.mean()))
    harmonics[0] = 0.0
    if harmonics.max() <= 1e-9 * np.abs(period_um).max(initial=0.0) * period_um.size:
        return 0.0
    counted = harmonics >= NEGLIGIBLE_HARMONIC * harmonics.max()
    frequency_hz = np.fft.rfftfreq(period_um.size, sample_period_s)[counted]
    left = np.abs(sensitivity(frequency_hz)) * harmonics[counted]
    return float(np.sqrt(left @ left / (harmonics[counted] @ harmonics[counted])))


def check_reach(period_um: FloatArray, sensitivity: Sensitivity, reference: Reference,
                model: StageModel, stage: StageClock, duration_s: float,
                watch: Watch | None = None) -> None:
    """Refuse a reference that a mode would not follow, and that the exact inverse cannot either.

    What the inverse could follow is played, so that modes can be compared; the run then tells
    that the stage did not follow.

    Parameters
    ----------
    period_um : ndarray, shape (m,)
        One period of the reference.
    sensitivity : callable
        Of the mode.
    reference, model, stage, duration_s, watch
        See `plan_mode`.

    Raises
    ------
    UnreachableReference
        Names the amplitude within reach.
    """
    if foreseen_share(period_um, stage.sample_period_s, sensitivity) >= SHARE_AT_REST:
        plan_mode("feedforward", reference, model, stage, duration_s, watch)
