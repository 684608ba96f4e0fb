# SPDX-License-Identifier: BSD-3-Clause
"""What an image needs to know of a scan: ``scan.json``, beside the plan and in the recording."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_common.schema import Document, Number, Numbers, SchemaError, entry, parsed
from piezo_recorder.reading.recording import RecordingError

SCAN_FILE = "scan.json"
FORMAT, VERSION = "piezo_scan", 1


class ScanFrame(Document):
    """The pixels of a scan's image, and the delays of the sensors."""

    TITLE: ClassVar[str] = "description of a scan"
    FORMAT: ClassVar[str] = FORMAT
    VERSION: ClassVar[int] = VERSION
    RENEW: ClassVar[str] = "plan the scan again"

    format: str = entry(f"Always {FORMAT}.")
    version: Number = entry(f"Always {VERSION}.")
    path: str = entry("Pattern, size and rate in words.")
    axes: list[str] = entry("Axes along the rows and the columns of the image; of a raster the "
                            "fast one first.", shortest=2, longest=2)
    pixels: list[int] = entry("Number of pixels along both axes.", shortest=2, longest=2)
    pixel_um: Numbers = entry("Size of a pixel along both axes.", unit="um", shortest=2, longest=2)
    centre_um: Numbers = entry("Centre of the image.", unit="um", shortest=2, longest=2)
    marked_pixels: int = entry("Samples of a frame that are marked as pixels.", at_least=1)
    sensor_delay_s: Numbers = entry("By how much the reading of either axis is late.", unit="s",
                                    shortest=2, longest=2)

    @property
    def corner_um(self) -> tuple[float, float]:
        """Return the lowest coordinates of the image, at the edge of the first pixel."""
        first, second = np.array(self.centre_um) - 0.5 * np.array(self.size_um)
        return float(first), float(second)

    @property
    def size_um(self) -> tuple[float, float]:
        """Return the size of the image along both axes."""
        return (self.pixels[0] * self.pixel_um[0], self.pixels[1] * self.pixel_um[1])

    def places_um(self) -> FloatArray:
        """Return the positions of the pixels along both axes, shape (rows, columns, 2)."""
        along = [corner + pixel * (np.arange(count) + 0.5) for corner, pixel, count in zip(
            self.corner_um, self.pixel_um, self.pixels, strict=True)]
        return np.stack(np.meshgrid(*along), axis=-1)


def frame_in(attachments: Mapping[str, bytes], path: str) -> ScanFrame:
    """Return the frame stored in a recording; RecordingError if there is none, or it is damaged."""
    if SCAN_FILE not in attachments:
        raise RecordingError(f"{path} holds no {SCAN_FILE}: record a scan with `stage scan`")
    try:
        return parsed(ScanFrame, attachments[SCAN_FILE].decode(errors="replace"))
    except SchemaError as error:
        raise RecordingError(f"{path}: {SCAN_FILE} {error}") from None
