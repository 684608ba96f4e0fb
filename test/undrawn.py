# SPDX-License-Identifier: BSD-3-Clause
"""Pictures of a single point, for tests that do not look at them."""

from typing import IO, Any

from matplotlib.figure import Figure
from PIL import Image


def save_point(figure: Figure, target: IO[bytes], **options: Any) -> None:
    """Save a picture of a single point in place of a figure."""
    Image.new("RGB", (1, 1)).save(target, "png")
