# SPDX-License-Identifier: BSD-3-Clause
"""Learn the voltages of a path from the measured motion, run by run.

Each line of the error's spectrum is divided by the response matrix of a model, and the resulting
voltage is added. This removes errors that repeat with the path: hysteresis, creep and model errors.
"""

from dataclasses import replace

import numpy as np

from piezo_client.scans import Scanned
from piezo_controller.axes.stored_scan import SAME_PERIOD, StoredScan
from piezo_controller.references.smooth_rise import minimum_jerk
from piezo_models.axes.coupled import CoupledModel

PASSED = 0.1
"""Smallest gain, relative to the DC gain in its worst direction, at which a line is learned: up to
three times the highest mode. With 0.03 the errors on the simulated XY stage are within a
fifth; at higher frequencies there is noise, and no model is known."""


def learned(run: Scanned, model: CoupledModel) -> StoredScan:
    """Return the scan with voltages that compensate the error of a run.

    The offset is not corrected, as creep changes it. Raises ValueError if the model has other axes
    or another sample period than the scan.
    """
    scan, samples = run.scan, len(run.scan.voltage_v)
    if model.axes != scan.axes or abs(
            model.sample_period_s / scan.sample_period_s - 1.0) > SAME_PERIOD:
        raise ValueError(
            f"the model has the axes {', '.join(model.axes)} at {1.0 / model.sample_period_s:.6g} "
            f"Hz, the scan {', '.join(scan.axes)} at {1.0 / scan.sample_period_s:.6g} Hz: give the "
            "model that it was planned with")
    response = model.response(np.fft.rfftfreq(samples, scan.sample_period_s)[1:])
    passed = np.linalg.svd(response, compute_uv=False)[:, -1]
    used = np.flatnonzero(passed >= PASSED * passed[0]) + 1
    error = np.fft.rfft(-run.error_um, axis=0)
    lines = np.zeros_like(error)
    lines[used] = np.linalg.solve(response[used - 1], error[used][..., None])[..., 0]
    more_v = np.fft.irfft(lines, samples, axis=0)
    begin = len(scan.begin_voltage_v)
    more_before_v = minimum_jerk(begin)[:, None] * more_v[np.arange(-begin, 0) % samples]
    return replace(scan, voltage_v=scan.voltage_v + more_v,
                   begin_voltage_v=scan.begin_voltage_v + more_before_v)
