# SPDX-License-Identifier: BSD-3-Clause
"""Whether a recording begins at rest."""

import numpy as np

from piezo_identification.conditioning.sensor_noise import noise_floor_um
from piezo_recorder.reading.recording import Recording

AT_REST = 20
"""Number of first samples with constant voltage for which a recording begins at rest."""

LONGEST_LOOK = 200
"""Largest number of samples at the end of a rest, or at the start if there is no rest, that show
whether the stage still rings."""

STILL = 3.0
"""Multiple of the sensor noise up to which these samples, minus the best parabola, show no ringing,
and up to which the ends of visits of a level are the same."""


def rings(recording: Recording, rows: slice) -> bool:
    """Return whether the displacement does more than creep and follow a slow voltage."""
    displacement_um = recording.displacement_um[rows]
    trend = np.column_stack([np.vander(np.linspace(-1.0, 1.0, displacement_um.size), 3),
                             recording.voltage_v[rows]])
    residual_um = displacement_um - trend @ np.linalg.lstsq(trend, displacement_um, rcond=None)[0]
    return bool(np.std(residual_um) > STILL * noise_floor_um(recording.displacement_um))


def rests_at_first(recording: Recording) -> bool:
    """Return whether a recording begins with a constant voltage, and without ringing."""
    moved = np.flatnonzero(np.diff(recording.voltage_v[:LONGEST_LOOK]))
    rest = 1 + int(moved[0]) if moved.size else min(recording.voltage_v.size, LONGEST_LOOK)
    return rest >= AT_REST and not rings(recording, slice(rest))
