# SPDX-License-Identifier: BSD-3-Clause
"""The end of the demo: a fault distorts the images of an XY stage, and its diagnosis corrects them.

The recording of the first, distorted scan is the one that is diagnosed. Stage, identification and
scan are called without nodes, while the nodes of the demo are at work.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from piezo_common.report_page import Picture, Section, pictured
from piezo_controller.axes.path_plan import PathPlan
from piezo_controller.axes.scan import scan
from piezo_controller.axes.stored_scan import stored_scan
from piezo_identification.axes.diagnose_axes import diagnose_axes
from piezo_identification.axes.identify_axes import identify_several_axes
from piezo_models.axes.identified_axes import IdentifiedAxes
from piezo_models.axes_model_file import save_axes_model
from piezo_recorder.images.image_page import distortion, write_images
from piezo_recorder.images.scan_image import image_of
from piezo_recorder.reading.axes import AxesRecording
from piezo_studies.coupled_scans.images import SIZE_UM, fields_figure, grating_under
from piezo_studies.coupled_scans.xy_stage import VOLTAGE_RANGE_V, imaged, linear_plant, recorded

LINES, RATE_HZ = 128, 125.0
"""Lines of the image, and lines a second: the third harmonic lies near the second mode."""

LEAK = 0.05
"""Fraction of the voltage of x that the fault adds to that of y: -26 dB, enough to be seen."""


@dataclass(frozen=True)
class DiagnosedScan:
    """A scan before and after its diagnosis."""

    summary: dict[str, Any]
    """Verdict of the diagnosis, errors of the model in percent, and of the images in pixels."""
    picture: Picture
    """The specimen, and its image before and after."""


def diagnosed_scan(directory: Path, lines: int = LINES) -> DiagnosedScan:
    """Identify the XY stage, scan a grating with a fault, diagnose this scan, and scan again.

    Models, verdict, images and their page are written into the directory.
    """
    plant = linear_plant()
    identified = identify_several_axes(recorded("multisine", 1, plant))
    plan = _raster(identified, lines)
    assert plan.frame is not None  # a raster has pixels
    specimen = grating_under(plan.frame)

    def scanned(plan: PathPlan) -> AxesRecording:
        planned, leaking = stored_scan(plan), np.array([[1.0, LEAK], [0.0, 1.0]])
        played = replace(planned, voltage_v=planned.voltage_v @ leaking,
                         begin_voltage_v=planned.begin_voltage_v @ leaking)
        return replace(imaged(played, specimen, plant), voltage_v=planned.voltage_v)

    recording = scanned(plan)
    diagnosis = diagnose_axes(identified, recording)
    extended_plan = _raster(diagnosis.extended, lines)
    images = {
        name: image_of(each, frame=planned.frame, position_um=planned.path.position_um)
        for name, each, planned in (("before", recording, plan),
                                    ("after", scanned(extended_plan), extended_plan))}
    diagnosis.write(directory)
    save_axes_model(directory / "model.json", identified)
    write_images(images, directory, specimen)
    errors = {str(name): {"rms_pixels": rms, "rms_calibrated_pixels": calibrated}
              for name, _, rms, calibrated in distortion(images, specimen).rows}
    figure = fields_figure({"specimen": specimen} | {
        f"{name}: {errors[name]['rms_pixels']:.2g} pixels RMS": image.field(image.values)
        for name, image in images.items()}, plan.frame)
    return DiagnosedScan(
        {"probabilities": diagnosis.probabilities, "effects": diagnosis.effects,
         "model_before": diagnosis.before, "model_after": diagnosis.after, **errors},
        pictured("Scan before and after", figure,
                 "A grating with grains, and its images by the commanded positions: with the model "
                 "as it was identified, and as the diagnosis extended it.", wide=True))


def _raster(model: IdentifiedAxes, lines: int) -> PathPlan:
    return scan(model, "raster", size_um=(SIZE_UM, SIZE_UM), lines=lines, rate_hz=RATE_HZ,
                voltage_range_v=VOLTAGE_RANGE_V)


def format_scan(summary: dict[str, Any]) -> str:
    """Return one line of text on the diagnosis and the images."""
    found, probability = next(iter(summary["probabilities"].items()))
    before, after = (summary[name]["rms_pixels"] for name in ("before", "after"))
    return (f"scan of an XY stage with a fault: {found} with probability {probability:.2f}; with "
            f"the extended model the image is distorted by {before:.2g} -> {after:.2g} pixels RMS")


def scan_section(scan: DiagnosedScan) -> Section:
    """Return the section of the report."""
    summary, parts = scan.summary, ("before", "after")
    found, probability = next(iter(summary["probabilities"].items()))
    values = ", ".join(
        f"{name} {effect['parameters'][name]:.3g} with a standard deviation of {off:.1g}"
        for effect in summary["effects"] for name, off in effect["standard_deviations"].items())
    rows = [["", *parts]]
    rows += [[text, *(f"{summary[part][name]:.3g}" for part in parts)] for text, name in (
        ("geometric error of the image, RMS in pixels", "rms_pixels"),
        ("the same without scale, rotation and squareness", "rms_calibrated_pixels"))]
    rows += [[f"error of the model for {axis}, e_y %",
              *(f"{summary['model_' + part][axis]['e_y_percent']:.3g}" for part in parts)]
             for axis in summary["model_before"]]
    return Section(
        "A scan before and after its diagnosis",
        ("A simulated stage of two axes, whose actuators are driven by charge, "
         "without hysteresis and creep, was identified. Then a fault of the wiring added "
         f"{100.0 * LEAK:g} % of the voltage of x to that of y, and the stage scanned a grating "
         f"with {RATE_HZ:g} lines a second. The lines are bent, because x excites a mode of y.",
         "The recording of this scan was diagnosed, and nothing else was played. The most probable "
         f"explanation is `{found}`, with the probability {probability:.3f} "
         f"({values or 'no effect is named'}). With the extended model the stage scanned again.",
         "The images and their files are in `scan/report.html`. The error that remains is that of "
         "the sensors, which are out of square."),
        rows, (scan.picture,))
