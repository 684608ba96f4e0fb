# SPDX-License-Identifier: BSD-3-Clause
"""Where an image shows the parts of a known specimen, compared with where they are."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates, spline_filter

from piezo_common.arrays import FloatArray
from piezo_common.gsf import Field
from piezo_recorder.images.scan_image import ScanImage

BLOCKS = 8
"""Along each axis. A block must contain edges of both directions: with pits at a distance of 2.5 um
and images of 20 um, it has one pit."""

STEPS = 10
"""Gauss-Newton steps; they converge within a few if the sensors are wrong by less than a pit."""

STEP_UM = 0.02
"""Distance over which slopes of the specimen are taken: a fraction of its edges."""

WHOLE = 0.9
"""Part of a block's pixels that must be reached. At the rim of what was reached, there are too few
edges, and the stage may not have moved evenly."""

DAMPING = 0.01
"""Part of the mean curvature that is added to that of each block. A block without edges then keeps
the shift that the sensors saw; others converge as fast."""


@dataclass(frozen=True, eq=False)
class GeometricError:
    """Shifts of the pixels of an image, in pixels."""

    shift: FloatArray
    """Position of what a pixel shows minus its place, (N, 2)."""
    place: FloatArray
    """Places of the pixels about the centre of the image, (N, 2)."""

    @property
    def rms(self) -> float:
        """Return the RMS length of the shifts without their mean, which is no distortion."""
        return _rms_without(self.shift, np.ones((len(self.shift), 1)))

    @property
    def rms_calibrated(self) -> float:
        """Return it without scale, rotation and squareness, which a known grating calibrates."""
        return _rms_without(self.shift, np.column_stack([np.ones(len(self.place)), self.place]))


def error_by_sensors(image: ScanImage) -> GeometricError:
    """Return the distortion that the sensors saw, of all pixels that were reached."""
    reached = _reached(image)
    return GeometricError((image.moved_um / image.frame.pixel_um)[reached], _places(image)[reached])


def error_by_specimen(image: ScanImage, specimen: Field) -> GeometricError:
    """Find which part of a specimen each pixel shows, with the errors of the sensors.

    To the shifts that the sensors saw, each of 8 x 8 blocks adds one that minimises the squared
    difference from the specimen, without an offset (damped Gauss-Newton). Blocks that were not
    reached as a whole do not count. The specimen is in the unit of the image and in the coordinates
    of the stage.
    """
    numbers, reached = _blocks(image.values.shape), _reached(image)
    share = np.bincount(numbers.ravel(), reached.ravel()) / np.bincount(numbers.ravel())
    used = reached & (share >= WHOLE)[numbers]
    _, block, count = np.unique(numbers[used], return_inverse=True, return_counts=True)
    seen_um = (image.frame.places_um() + image.moved_um)[used]
    surface = spline_filter(specimen.values, mode="mirror")

    def height(position_um: FloatArray) -> FloatArray:
        found: FloatArray = map_coordinates(
            surface, specimen.pixels_at(position_um), mode="nearest", prefilter=False)
        return found

    def of_blocks(each: FloatArray) -> FloatArray:
        return np.bincount(block, each) / count

    more_um = np.zeros((len(count), 2))
    for _ in range(STEPS):
        at_um = seen_um + more_um[block]
        left = image.values[used] - height(at_um)
        slopes = np.column_stack([
            (height(at_um + step) - height(at_um - step)) / (2.0 * STEP_UM)
            for step in STEP_UM * np.eye(2)])
        left -= of_blocks(left)[block]
        slopes -= np.column_stack([of_blocks(column) for column in slopes.T])[block]
        curvature = np.array([[of_blocks(one * other) for one in slopes.T]
                              for other in slopes.T]).transpose(2, 0, 1)
        damping = DAMPING * 0.5 * np.trace(curvature, axis1=1, axis2=2).mean()
        target = np.column_stack([of_blocks(column * left) for column in slopes.T])
        more_um += np.linalg.solve(curvature + damping * np.eye(2), target[..., None])[..., 0]
    shift_um = image.moved_um[used] + more_um[block]
    return GeometricError(shift_um / image.frame.pixel_um, _places(image)[used])


def _reached(image: ScanImage) -> NDArray[np.bool_]:
    return np.isfinite(image.values)


def _blocks(shape: tuple[int, ...]) -> NDArray[np.int64]:
    """Return the number of the block of each pixel."""
    row, column = (np.arange(count) * BLOCKS // count for count in shape)
    return row[:, None] * BLOCKS + column


def _places(image: ScanImage) -> FloatArray:
    places: FloatArray = (image.frame.places_um() - image.frame.centre_um) / image.frame.pixel_um
    return places


def _rms_without(shift: FloatArray, known: FloatArray) -> float:
    left = shift - known @ np.linalg.lstsq(known, shift, rcond=None)[0]
    return float(np.sqrt(np.mean(np.sum(left**2, axis=1))))
