# SPDX-License-Identifier: BSD-3-Clause
"""Check that a feedback law is safe with the plant that it declares."""

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_models.feedback_law.feedback_law import (
    DeclaredPlant,
    FeedbackLaw,
    FeedbackLawError,
    LinearBlock,
)
from piezo_models.linear.lifted import lift

# A mode on the unit circle never decays; the rounding of eigenvalues is far less than this margin.
LARGEST_EIGENVALUE = 1.0 - 1e-9
# A loop that amplifies errors by more than this is not useful. PID by the rules of Ziegler and
# Nichols, the least damped design of this suite, reaches about 5.
LARGEST_SENSITIVITY = 10.0
# A gain beyond the declared ones by this factor is that of another stage: the loops of this suite
# have gain margins of 1.4 to 2, and the secant of an approach is within 1.5 of the declared gains.
OTHER_GAIN = 3.0
FREQUENCIES = 400
LOWEST_FREQUENCY = 1e-4  # of the tick's rate


def check_law(law: FeedbackLaw, samples_per_tick: int, lead_ticks: int = 0) -> None:
    """Reject a law that is unstable with its declared plant, or amplifies errors too much.

    Voltages are written ahead of the measurement by some ticks. Raises `FeedbackLawError`, which
    names the gain of the hysteresis.
    """
    if lead_ticks and not law.sample.empty:
        raise FeedbackLawError("this stage is written ahead, so that no feedback acts from sample "
                               "to sample: use tick alone")
    _check_inverse_gain(law)
    # Behind its inverse the hysteresis has the gain 1, and the law's own gain is known.
    gains = law.plant.gains_um_per_v if law.inverse is None else [law.inverse.gain_um_per_v]
    for gain_um_per_v in gains:
        a, b, c = _tick_plant(law, gain_um_per_v, samples_per_tick, law.delay_ticks + lead_ticks)
        gain = " and ".join(f"{each:.3g}" for each in np.atleast_1d(gain_um_per_v))
        where = f"with the declared model at a hysteresis gain of {gain} um/V"
        largest = np.abs(np.linalg.eigvals(_closed(a, b, c, law.tick))).max()
        if not largest <= LARGEST_EIGENVALUE:
            raise FeedbackLawError(f"the feedback law is not stable {where} (an eigenvalue has the "
                                   f"size {largest:.4g}): design it for this stage")
        sensitivity = max(
            _peak_sensitivity(LinearBlock(a, b, c, np.zeros((len(c), b.shape[1]))), law.tick),
            _sampled_peak(law, gain_um_per_v))
        if not sensitivity <= LARGEST_SENSITIVITY:
            raise FeedbackLawError(
                f"the feedback law makes errors up to {sensitivity:.3g} times as large {where}, "
                f"more than {LARGEST_SENSITIVITY:g} times: lower its gain")


def _check_inverse_gain(law: FeedbackLaw) -> None:
    """Reject the inverse of another stage's hysteresis, which would change the loop gain."""
    if law.inverse is None:
        return
    hysteresis, declared = law.inverse.hysteresis, law.plant.gains_um_per_v
    gain_um_per_v = hysteresis.mean_gain_um_per_v
    lowest, highest = float(np.min(declared)), float(np.max(declared))
    if not lowest / OTHER_GAIN <= gain_um_per_v <= highest * OTHER_GAIN:
        raise FeedbackLawError(
            f"the hysteresis of the law has {gain_um_per_v:.3g} um/V over its range, and its model "
            f"declares {lowest:.3g} to {highest:.3g} um/V: take both from one model")


def declared_plant(plant: DeclaredPlant, gain_um_per_v: float | FloatArray,
                   sample: LinearBlock) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the plant from voltage to displacement at the sample rate: its matrices A, B and C.

    It includes the closed loop of the block at the sample rate, whose output acts one sample late.
    B has a column and C a row for each axis.
    """
    a, b, c, _ = plant.linear.matrices
    b = gain_um_per_v * b
    if sample.empty:
        return a, b, c
    n, m = plant.linear.order, sample.order
    closed = np.zeros((n + m + 1, n + m + 1))
    closed[:n, :n], closed[:n, n + m:] = a, b
    closed[n:n + m, :n], closed[n:n + m, n:n + m] = -sample.b[:, None] * c, sample.a
    closed[n + m, :n], closed[n + m, n:n + m] = -sample.d * c[0], sample.c
    padding = np.zeros((m + 1, 1))
    return closed, np.r_[b, padding], np.c_[c, padding.T]


def _tick_plant(law: FeedbackLaw, gain_um_per_v: float | FloatArray, samples_per_tick: int,
                delay_ticks: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    return lift(*declared_plant(law.plant, gain_um_per_v, law.sample), samples_per_tick,
                delay_ticks)


def _closed(a: FloatArray, b: FloatArray, c: FloatArray, block: LinearBlock) -> FloatArray:
    """Return the system matrix of the loop with negative feedback."""
    own_a, own_b, own_c, own_d = block.matrices
    return np.block([[a - b @ own_d @ c, b @ own_c], [-own_b @ c, own_a]])


def _sampled_peak(law: FeedbackLaw, gain_um_per_v: float | FloatArray) -> float:
    """Return the peak sensitivity of the loop at the sample rate, which acts one sample late."""
    if law.sample.empty:
        return 1.0
    points = np.exp(2j * np.pi * np.geomspace(LOWEST_FREQUENCY, 0.5, FREQUENCIES))
    loop = gain_um_per_v * law.plant.linear.response(points) * law.sample.response(points) / points
    return float(np.abs(1.0 / (1.0 + loop)).max())


def _peak_sensitivity(plant: LinearBlock, block: LinearBlock) -> float:
    points = np.exp(2j * np.pi * np.geomspace(LOWEST_FREQUENCY, 0.5, FREQUENCIES))
    loop = plant.response(points) @ block.response(points).reshape(
        len(points), plant.b.shape[1], -1)
    # The smallest singular value.
    return float(1.0 / np.linalg.norm(np.eye(len(plant.c)) + loop, -2, axis=(1, 2)).min())
