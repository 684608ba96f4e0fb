# SPDX-License-Identifier: BSD-3-Clause
"""The table of a check as text."""

import numpy as np

from piezo_identification.recording_check.check import RecordingCheck
from piezo_identification.recording_check.suitability import Suitability
from piezo_recorder.reading.recording_view import error_um


def check_table(check: RecordingCheck, fit_for: dict[str, Suitability]) -> list[str]:
    """Return the lines of the table: measured properties, then suitability."""
    lines = [f"{name:22}{value}" for name, value in measured_rows(check)]
    lines.append("")
    lines += [f"{'can stand for ' + name:26}{each.verdict:8}{each.reason}"
              for name, each in fit_for.items()]
    return lines


def measured_rows(check: RecordingCheck) -> list[tuple[str, str]]:
    """Return the measured properties of a recording as pairs of name and value."""
    recording, period_s = check.recording, check.sample_period_s
    of_segment = "" if not check.gaps else (
        f" in {check.gaps + 1} segments, of which the longest, {len(recording.voltage_v)} samples, "
        "is looked at")
    rows = [
        ("samples", f"{check.samples}{of_segment}"),
        *_left_out(check),
        ("duration", f"{check.duration_s:.5g} s"),
        ("sample period", f"{period_s:.6g} s ({1.0 / period_s:.6g} Hz)"),
        ("jitter", f"{recording.jitter_s:.2g} s RMS ({100.0 * recording.jitter_s / period_s:.2g} % "
         "of the period)"),
        ("voltage", _range(recording.voltage_v, "V")),
        ("displacement", _range(recording.displacement_um, "um")),
        *_tracking(check),
        ("gain", f"{check.range_um / check.swing_v:.4g} um/V, range over swing"
         if check.swing_v else "none: the voltage never changes"),
        ("noise", f"{check.noise_um:.3g} um RMS" if np.isfinite(check.noise_um) else "unknown"),
        ("drift", f"{check.drift_um:.3g} um over the recording" if np.isfinite(check.drift_um)
         else "unknown"),
        ("outliers", f"{check.outliers}"),
        ("waveform", f"{check.waveform.kind}: {check.waveform.text}"),
        ("state at the start", check.start),
        ("Preisach plane", f"{100.0 * check.visited_fraction:.1f} % visited, of the plane over "
         "this range"),
    ]
    return rows + _distortion(check)


def _left_out(check: RecordingCheck) -> list[tuple[str, str]]:
    """Return a row that names the omitted rows; empty if all are used."""
    before, behind = check.left_out
    if not before and not behind:
        return []
    parts = []
    if before:
        parts.append(f"1 to {before}")
    if behind:
        last = before + check.samples + behind
        parts.append(f"{last - behind + 1} to {last}")
    return [("left out", f"rows {' and '.join(parts)}, on the way from rest and back")]


def _tracking(check: RecordingCheck) -> list[tuple[str, str]]:
    """Return rows for reference and error of a tracking run; empty for other recordings."""
    errors_um = error_um(check.recording)
    if not errors_um.size:
        return []
    followed = check.reference_um[np.isfinite(check.reference_um)]
    return [("reference", _range(followed, "um")),
            ("error", f"{np.sqrt(np.mean(errors_um**2)):.4g} um RMS, largest "
             f"{np.abs(errors_um).max():.4g} um, with the way to its beginning")]


def _distortion(check: RecordingCheck) -> list[tuple[str, str]]:
    """Return a row for the distortion of an odd multisine; empty for other voltages."""
    found = check.distortion
    if found is None:
        return []
    text = f"noise of a period {found.percent(found.noise_of_period_um):.3g} %"
    for name, part_um in ("even", found.even_um), ("odd", found.odd_um):
        least = "" if part_um > found.significant_um else (
            f" not significant, below {found.percent(found.significant_um):.2g} %")
        text += f", {name} {found.percent(part_um):.3g} %{least}"
    return [("distortion", f"{text}; of the answer up to {found.frequency_hz[-1]:.4g} Hz")]


def _range(values: np.ndarray, unit: str) -> str:
    return f"{values.min():.5g} to {values.max():.5g} {unit}"
