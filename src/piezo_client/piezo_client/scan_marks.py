# SPDX-License-Identifier: BSD-3-Clause
"""Mark the places of a path where a run has measured them, to play it again with these marks."""

from dataclasses import replace

import numpy as np

from piezo_client.scans import Scanned
from piezo_controller.axes.path_marks import marks_by_position
from piezo_controller.axes.stored_scan import StoredScan


def marked(run: Scanned) -> StoredScan:
    """Return the scan with its marks when the axes passed their places in the last period of a run.

    The delays of the sensors are those of the plan. The voltages do not change. Raises ValueError
    if the scan has no pixels.
    """
    scan, frame = run.scan, run.scan.checked_frame()
    delay_s = np.zeros(len(scan.axes))
    delay_s[[scan.axes.index(axis) for axis in frame.axes]] = frame.sensor_delay_s
    return replace(scan, marks=marks_by_position(
        scan.position_um, scan.marks, run.displacement_um, delay_s / scan.sample_period_s))
