# SPDX-License-Identifier: BSD-3-Clause
"""Error that a mode without an inverse is expected to have, predicted from its linear loop."""

from collections.abc import Callable

import numpy as np

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_controller.references.kind import Reference, Watch
from piezo_controller.tracking.tracking_modes import StageClock, plan_mode
from piezo_models.cascade import StageModel
from piezo_models.linear.dynamics import zoh_response

SHARE_AT_REST = 0.9
"""Rms error, as a part of that at rest, from which on a reference counts as not followed.
Four fifths of its power then remain as error."""

# Harmonics below this part of the largest contribute less than a millionth of the power.
NEGLIGIBLE_HARMONIC = 1e-3

Sensitivity = Callable[[FloatArray], ComplexArray]
"""Returns, for frequencies (Hz), the part of the reference that remains as error."""


def open_loop_sensitivity(model: StageModel, sample_period_s: float) -> Sensitivity:
    """Return the sensitivity of the linear part of a model without an inverse."""
    linear = model.linear()
    return lambda frequency_hz: 1.0 - zoh_response(linear, frequency_hz, sample_period_s)


def foreseen_share(period_um: FloatArray, sample_period_s: float,
                   sensitivity: Sensitivity) -> float:
    """Predict the rms error, as a part of the error of a stage at rest at the reference's mean.

    The period has the shape (m,); the result is 0 for a constant reference.
    """
    harmonics = np.abs(np.fft.rfft(period_um - period_um.mean()))
    harmonics[0] = 0.0
    if harmonics.max() <= 1e-9 * np.abs(period_um).max(initial=0.0) * period_um.size:
        return 0.0
    counted = harmonics >= NEGLIGIBLE_HARMONIC * harmonics.max()
    frequency_hz = np.fft.rfftfreq(period_um.size, sample_period_s)[counted]
    residual = np.abs(sensitivity(frequency_hz)) * harmonics[counted]
    return float(np.sqrt(residual @ residual / (harmonics[counted] @ harmonics[counted])))


def check_reach(period_um: FloatArray, sensitivity: Sensitivity, reference: Reference,
                model: StageModel, stage: StageClock, duration_s: float,
                watch: Watch | None = None) -> None:
    """Raise `UnreachableReference` if neither the mode nor the exact inverse follows a reference.

    A reference that the inverse could follow is played, so that modes can be compared; the run then
    reports that the stage did not follow. The arguments after the sensitivity are those of
    `plan_mode`.
    """
    if foreseen_share(period_um, stage.sample_period_s, sensitivity) >= SHARE_AT_REST:
        plan_mode("feedforward", reference, model, stage, duration_s, watch)
