# SPDX-License-Identifier: BSD-3-Clause
"""Work without pictures and parallel fits, which take longer than what tests look at."""

from typing import IO, Any

from matplotlib.figure import Figure
from PIL import Image

from piezo_common import report_page, side_by_side


def work_undrawn() -> None:
    """Let this process draw nothing, and use one core."""
    for owner, name, instead in (
            (Figure, "savefig", save_point), (report_page, "interactive_item", lambda *_: None),
            (side_by_side, "cores", lambda: 1)):
        setattr(owner, name, instead)


def save_point(figure: Figure, target: IO[bytes], **options: Any) -> None:
    """Save a picture of a single point in place of a figure."""
    Image.new("RGB", (1, 1)).save(target, "png")
