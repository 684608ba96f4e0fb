# SPDX-License-Identifier: BSD-3-Clause
"""A calibration grating: square pits in rows and columns, with some grains on it."""

import numpy as np
from scipy.ndimage import gaussian_filter

from piezo_common.gsf import Field

PIXEL_UM = 0.05
EDGE_UM = 0.06
"""RMS width of the edges, to which a tip of 50 nm rounds them."""

DEPTH_UM = 0.1
GRAINS_PER_UM2 = 0.15
GRAIN_UM = (0.1, 0.3)
"""Least and largest RMS radius of a grain; it is as high as a third of that."""


def grating(centre_um: tuple[float, float], size_um: float, pitch_um: float, seed: int) -> Field:
    """Return the heights of a square grating (um) about a centre in coordinates of the stage.

    Each pit is half as wide as their distance, the pitch. The seed gives places and sizes of the
    grains.
    """
    pixels = round(size_um / PIXEL_UM)
    along = (np.arange(pixels) + 0.5) * PIXEL_UM
    inside = along % pitch_um < 0.5 * pitch_um
    heights = gaussian_filter(-DEPTH_UM * np.outer(inside, inside), EDGE_UM / PIXEL_UM)
    random = np.random.default_rng(seed)
    for _ in range(round(GRAINS_PER_UM2 * size_um**2)):
        at, radius = random.uniform(0.0, size_um, 2), random.uniform(*GRAIN_UM)
        y, x = (np.exp(-0.5 * ((along - each) / radius) ** 2) for each in at)
        heights += radius / 3.0 * np.outer(y, x)
    return Field(heights, (centre_um[0] - 0.5 * size_um, centre_um[1] - 0.5 * size_um),
                 (size_um, size_um), "um", f"grating of {pitch_um:g} um")
