# SPDX-License-Identifier: BSD-3-Clause
"""The page of a scan: its images side by side, and how far they are distorted."""

import argparse
from collections.abc import Mapping
from pathlib import Path

from piezo_common.gsf import Field, read_gsf
from piezo_common.report_page import Section, pictured, render_page
from piezo_common.summary_table import SummaryTable
from piezo_recorder.images.geometric_error import error_by_sensors, error_by_specimen
from piezo_recorder.images.image_files import image_figure, write_image
from piezo_recorder.images.scan_image import ScanImage, image_of
from piezo_recorder.reading.axes import read_axes

PAGE = "report.html"


def distortion(images: Mapping[str, ScanImage], specimen: Field | None = None) -> SummaryTable:
    """Return the geometric errors of images as a table, in pixels."""
    rows = []
    for name, image in images.items():
        seen = error_by_sensors(image).rms
        known = None if specimen is None else error_by_specimen(image, specimen)
        rows.append((name, seen, *((known.rms, known.rms_calibrated) if known else (None, None))))
    return SummaryTable(
        "Geometric error, RMS in pixels",
        ("image", "by the sensors", "by the specimen", "without scale, rotation, squareness"), rows,
        ("by the sensors: measured position of what each pixel shows minus its place, without the "
         "mean",
         "by the specimen: the same with the errors of the sensors, which 8 x 8 blocks show"))


def write_images(images: Mapping[str, ScanImage], folder: Path,
                 specimen: Field | None = None) -> list[str]:
    """Write the files of images and their page; return lines to print.

    Parameters
    ----------
    images : mapping
        Images by what they are, which also names their files.
    specimen : Field, optional
        What they show; adds the geometric error to the page.
    """
    folder.mkdir(parents=True, exist_ok=True)
    lines = [line for name, image in images.items()
             for line in write_image(image, folder, name.replace(" ", "_").replace(",", ""))]
    table = distortion(images, specimen)
    first = next(iter(images.values()))
    page = render_page(f"Images of a {first.frame.path}", [], [
        Section("Images", pictures=[
            pictured(name, image_figure(image, name), f"{image.signal}: {name}.")
            for name, image in images.items()]),
        Section(table.title, table.notes, [table.heads, *[
            [cell if isinstance(cell, str) else "" if cell is None else f"{cell:.3g}"
             for cell in row] for row in table.rows]])])
    (folder / PAGE).write_text(page, encoding="utf-8")
    return [str(table), *lines, f"report: {folder / PAGE}"]


def make_images(options: argparse.Namespace) -> None:
    """Make the image of each recording, and the page of all."""
    images = {path.stem: image_of(recording, options.signal)
              for path in options.data for recording in read_axes(path)}
    specimen = options.specimen and read_gsf(options.specimen)
    print("\n".join(write_images(images, options.output, specimen)))
