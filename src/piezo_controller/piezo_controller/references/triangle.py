# SPDX-License-Identifier: BSD-3-Clause
"""A triangle whose corners stay within what the stage can follow."""

import numpy as np
from scipy.special import sici

from piezo_common.arrays import FloatArray
from piezo_controller.references.sines import Waves

BANDWIDTH_HZ = 2000.0
# For more sines a closed formula is used: the ideal triangle less the remaining terms.
MOST_SUMMED = 500


def triangle_wave(angle_rad: FloatArray, frequency_hz: float) -> FloatArray:
    """Return the Fourier series of a unit triangle up to 2 kHz, rising through zero at angle 0."""
    orders = max(int((BANDWIDTH_HZ / frequency_hz + 1 + 1e-9) // 2), 1)
    return _summed(angle_rad, orders) if orders <= MOST_SUMMED else _closed(angle_rad, orders)


def _summed(angle_rad: FloatArray, orders: int) -> FloatArray:
    odd = np.arange(1, 2 * orders, 2)
    wave = np.zeros_like(angle_rad)
    for order, sign in zip(odd, np.where(odd % 4 == 1, 1.0, -1.0), strict=True):
        wave += sign * np.sin(order * angle_rad) / order**2
    return wave / np.sum(1 / odd.astype(float) ** 2)


def _closed(angle_rad: FloatArray, orders: int) -> FloatArray:
    """Return the same to within 1e-9, at a cost that does not depend on the number of orders."""
    from_crest = np.abs(np.mod(angle_rad + np.pi / 2, 2 * np.pi) - np.pi)
    from_tip = np.minimum(from_crest, np.pi - from_crest)
    sign = np.where(from_crest < np.pi / 2, 1.0, -1.0)
    straight = np.pi / 4 * (np.pi / 2 - from_tip)
    return sign * (straight - _left_out(from_tip, orders)) / (
        np.pi**2 / 8 - _left_out(np.zeros(1), orders))


def _left_out(distance: FloatArray, orders: int) -> FloatArray:
    """Return the sum of cos(k d) / k**2 over the odd k above 2 orders.

    The sum is replaced by an integral over k; sin(d) / d corrects the error of the midpoint rule.
    """
    first = 2.0 * orders
    integral = np.cos(first * distance) / first - distance * (
        np.pi / 2 - sici(first * distance)[0])
    return integral / 2 / np.sinc(distance / np.pi)


TRIANGLE = Waves(triangle_wave)
