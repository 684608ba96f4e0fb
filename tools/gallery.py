# SPDX-License-Identifier: BSD-3-Clause
"""Draw the pictures of docs/gallery.md anew: python tools/gallery.py DEMO, such as runs/demo."""

import base64
import io
import re
import sys
from pathlib import Path

from PIL import Image
from run_cells import cells_of, run_cells

from piezo_offline.piezo_command import main as piezo

ROOT = Path(__file__).parents[1]
PICTURES = ROOT / "docs" / "pictures" / "gallery"
WIDTH, COLOURS = 960, 64
"""Of a picture: enough for a page of the site, at a third of the bytes."""

OF_PAGES = {
    "loops": ("report.html", "Loops"),
    "density": ("report.html", "Density"),
    "response": ("report.html", "Frequency response"),
    "tracking_500_hz": ("report.html", "Tracking at 500 Hz"),
    "spectra_500_hz": ("report.html", "Spectra at 500 Hz"),
    "residuals": ("decision/diagnosis/report.html", "Residuals"),
    "scan": ("report.html", "Scan before and after"),
    "steps": ("controller_report.html", "Step responses"),
    "nyquist": ("controller_report.html", "Nyquist diagram"),
}
"""Page of the demo's folder, and name of the picture on it, by the name of the file."""


def main(arguments):
    """Design the controller of a demo's model, and draw the pictures."""
    demo = Path(arguments[0])
    piezo(["design", "--model", str(demo / "model.json"),
           "--output", str(demo / "controller.json")])
    for name, (page, picture) in OF_PAGES.items():
        found = re.search(rf'alt="{picture}" src="data:image/webp;base64,([^"]+)"',
                          (demo / page).read_text(encoding="utf-8"))
        write(name, base64.b64decode(found[1]))
    scan, = (cell for cell in cells_of(ROOT / "docs" / "several_axes.md") if "piezo.scan" in cell)
    (_, path), = run_cells([scan], {})
    write("path", path)


def write(name, image):
    """Write a picture that is small enough to be kept with the pages."""
    with Image.open(io.BytesIO(image)) as picture:
        small = picture.convert("RGB")
    small.thumbnail((WIDTH, 2 * WIDTH))
    small.quantize(COLOURS).save(PICTURES / f"{name}.png", optimize=True)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
