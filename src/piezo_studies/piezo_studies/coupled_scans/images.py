# SPDX-License-Identifier: BSD-3-Clause
"""Images of a grating from the simulated XY stage, and how far they are distorted."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from piezo_common.gsf import Field
from piezo_common.picture_style import WIDE_IN, label, new_figure
from piezo_controller.axes.path_plan import PathPlan
from piezo_controller.axes.scan import scan
from piezo_controller.axes.stored_scan import stored_scan
from piezo_models.axes.coupled import CoupledModel
from piezo_models.axes.identified_axes import IdentifiedAxes
from piezo_recorder.images.geometric_error import error_by_sensors, error_by_specimen
from piezo_recorder.images.scan_frame import ScanFrame
from piezo_recorder.images.scan_image import ScanImage, image_of
from piezo_sim.specimen.grating import grating
from piezo_studies.coupled_scans.scan_trials import VOLTAGE_RANGE_V
from piezo_studies.coupled_scans.xy_stage import imaged
from piezo_studies.tables import markdown_table

SIZE_UM, LINES, RATE_HZ = 20.0, 256, 20.0
PITCH_UM, SEED = 2.5, 1
BEYOND_UM = 10.0
"""By how much the grating reaches beyond the image: farther than any distortion."""


def images_of_grating(model: CoupledModel | IdentifiedAxes, lines: int = LINES,
                      rate_hz: float = RATE_HZ) -> tuple[dict[str, ScanImage], Field]:
    """Scan a grating without an inverse and with that of a model; return images and specimen.

    Each scan gives one image by commanded and one by measured positions.
    """
    plan = scan(model, "raster", size_um=(SIZE_UM, SIZE_UM), lines=lines, rate_hz=rate_hz,
                voltage_range_v=VOLTAGE_RANGE_V)
    frame = plan.frame
    assert frame is not None  # a raster has pixels
    specimen = grating_under(frame)
    images: dict[str, ScanImage] = {}
    for name, each in (("no inverse", plan.without_inverse()), ("inverse", plan)):
        images |= _both(name, each, specimen)
    return images, specimen


def grating_under(frame: ScanFrame) -> Field:
    """Return the grating of the study, about the centre of an image."""
    first_um, second_um = frame.centre_um
    return grating((first_um, second_um), SIZE_UM + 2.0 * BEYOND_UM, PITCH_UM, SEED)


def _both(name: str, plan: PathPlan, specimen: Field) -> dict[str, ScanImage]:
    recording = imaged(stored_scan(plan), specimen)
    return {f"{name}, as commanded": image_of(recording, frame=plan.frame,
                                              position_um=plan.path.position_um),
            f"{name}, as measured": image_of(recording, frame=plan.frame)}


def image_table(images: Mapping[str, ScanImage], specimen: Field) -> str:
    """Return the geometric errors of images as Markdown."""
    rows = []
    for name, image in images.items():
        known = error_by_specimen(image, specimen)
        numbers = (error_by_sensors(image).rms, known.rms, known.rms_calibrated)
        rows.append((name, *(f"{number:.2g}" for number in numbers)))
    return markdown_table(("RMS in pixels", "by the sensors", "by the specimen",
                           "without scale, rotation, squareness"), rows)


def images_figure(images: Mapping[str, ScanImage]) -> Figure:
    """Draw the first image and the last one side by side."""
    (before, first), *_, (after, last) = images.items()
    return fields_figure({before: first.field(first.values), after: last.field(last.values)},
                         last.frame)


def fields_figure(fields: Mapping[str, Field], frame: ScanFrame) -> Figure:
    """Draw maps side by side over the area of an image, with the colours of the last one."""
    figure = new_figure(0.1 + WIDE_IN / len(fields), WIDE_IN)
    *_, last = fields.values()
    low, high = np.nanpercentile(last.values, (1.0, 99.0))
    for axes, (name, field) in zip(figure.subplots(1, len(fields)), fields.items(), strict=True):
        axes.imshow(field.values, "afmhot", origin="lower", vmin=low, vmax=high,
                    extent=_edges(field.corner_um, field.size_um))
        axes.axis(_edges(frame.corner_um, frame.size_um))
        label(axes, f"{frame.axes[0]} (um)", f"{frame.axes[1]} (um)", name)
        axes.grid(False)
    return figure


def _edges(corner_um: Sequence[float], size_um: Sequence[float]) -> tuple[float, ...]:
    """Return left, right, lower and upper edge."""
    (left, low), (width, height) = corner_um, size_um
    return left, left + width, low, low + height
