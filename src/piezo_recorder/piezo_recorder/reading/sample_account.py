# SPDX-License-Identifier: BSD-3-Clause
"""Description of the samples of a recording: ``report RECORDING``."""

import argparse

import numpy as np

from piezo_common.command_line import print_next
from piezo_recorder.reading.reader import read_recording
from piezo_recorder.reading.recording import Recording
from piezo_recorder.reading.recording_view import error_um

GAPS_STATUS = 1


def report(recording: Recording) -> list[str]:
    """Return a description of a recording; lines on missing samples begin with ``error``."""
    periods_s = np.unique(recording.sample_periods_s)
    lines = [
        f"{recording.path}: {len(recording.voltage_v)} samples, index "
        f"{recording.sample_index[0]} to {recording.sample_index[-1]}, "
        f"{recording.time_s[-1]:.6g} s",
        f"sample periods {', '.join(f'{period_s:g} s' for period_s in periods_s[:8])}"
        + (" ..." if len(periods_s) > 8 else "")]
    errors_um = error_um(recording)
    if errors_um.size:
        lines.append(f"reference of {errors_um.size} samples: rms error "
                     f"{np.sqrt(np.mean(errors_um**2)):.4g} um, largest "
                     f"{np.abs(errors_um).max():.4g} um, with the way to its beginning")
    if recording.attachments:
        lines.append(f"attachments {', '.join(sorted(recording.attachments))}")
    if not recording.complete:
        lines.append("the recorder was killed: make it whole with the command repair")
    lines += recording.notes
    lines += [f"error: {count} samples are missing from sample {first} on"
              for first, count in recording.gaps]
    return lines


def report_file(options: argparse.Namespace) -> int:
    """Print the description of a recording; return 1 if samples are missing."""
    recording = read_recording(options.recording, several_axes=True)
    print("\n".join(report(recording)))
    print_next(options, "piezo_identification", "check", "--data", options.recording)
    return GAPS_STATUS if recording.gaps else 0
