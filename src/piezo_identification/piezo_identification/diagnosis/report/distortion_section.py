# SPDX-License-Identifier: BSD-3-Clause
"""The section of the report on distortion, from a multisine with omitted lines."""

from piezo_common.arrays import FloatArray
from piezo_common.report_page import Picture, Section
from piezo_identification.analysis.distortion_over_frequency import (
    distortion_png,
    distortion_rows,
)
from piezo_identification.analysis.error_distortion import error_distortion
from piezo_identification.simulation.simulated_recording import SimulatedRecording


def distortion_sections(part: SimulatedRecording, before_um: FloatArray,
                        after_um: FloatArray) -> list[Section]:
    """Return the section on distortion from residuals, (N,); empty for other voltages."""
    before, after = (error_distortion(part, residual) for residual in (before_um, after_um))
    if before is None or after is None:
        return []
    answer = before.answer
    rows: list[tuple[str, ...]] = [
        ("part of the answer (%)", "stage", "error before", "error after")]
    for name, value in (("linear", "linear_um"), ("even distortion", "even_um"),
                        ("odd distortion", "odd_um"), ("noise of a period", "noise_of_period_um"),
                        ("significant above", "significant_um")):
        rows.append((name, *(f"{100.0 * getattr(found, value) / answer.answer_um:.3g}"
                             for found in (answer, before.error, after.error))))
    pictures = [
        Picture(name, caption, distortion_png(found), wide=True) for name, caption, found in (
            ("Distortion of the stage", "Answer, noise, even and odd distortion, without any "
             "model.", answer),
            ("Distortion of the residual", "The same with the extended model.", after.error))]
    return [
        Section(f"Distortion in {part.path}", (before.sentence(),), rows, pictures),
        Section("Distortion over frequency", (), distortion_rows(answer)),
    ]
