# SPDX-License-Identifier: BSD-3-Clause
"""A specimen under the tip of a simulated stage: its height, and a camera's brightness."""

import numpy as np
from scipy.ndimage import map_coordinates, spline_filter

from piezo_common.arrays import FloatArray
from piezo_common.gsf import Field
from piezo_sim.plant.random_stream import NormalStream, bits_for

HEIGHT_NOISE_UM = 2e-4
"""RMS noise of the height: some tenths of a nanometre, as of the deflection of an AFM."""

BRIGHTNESS_NOISE = 0.01
"""RMS noise of the brightness, whose range is 0 to 1."""

LIGHT = 0.5
"""Brightness that a slope of 1 towards the light adds to that of level ground, 0.5."""


class Specimen:
    """A specimen at rest, under a tip that moves over it.

    The field has the heights in um over the true positions; outside, those of the edge go on. The
    seed is that of the noise of the detectors `signals`: the height in um, and the brightness under
    light from the side.
    """

    signals = ("height_um", "camera")

    def __init__(self, field: Field, seed: int) -> None:
        self._field = field
        rows, columns = field.values.shape
        slopes = np.gradient(field.values, field.size_um[1] / rows, field.size_um[0] / columns)
        brightness = np.clip(0.5 + LIGHT * (slopes[0] + slopes[1]) / np.sqrt(2.0), 0.0, 1.0)
        self._maps = [spline_filter(each, mode="mirror") for each in (field.values, brightness)]
        self._noise = [NormalStream(bits_for(name, seed)) for name in self.signals]

    def measured(self, true_um: FloatArray) -> FloatArray:
        """Return what the detectors measure at true positions, shape (n, 2) both."""
        rows, columns = self._field.values.shape
        at = np.clip(self._field.pixels_at(true_um), 0.0, [[rows - 1.0], [columns - 1.0]])
        noise = np.column_stack([rms * stream.next(len(true_um)) for rms, stream in zip(
            (HEIGHT_NOISE_UM, BRIGHTNESS_NOISE), self._noise, strict=True)])
        measured: FloatArray = noise + np.column_stack([
            map_coordinates(each, at, mode="mirror", prefilter=False) for each in self._maps])
        return measured
