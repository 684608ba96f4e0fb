# SPDX-License-Identifier: BSD-3-Clause
"""Learn the voltages of a path from what the axes did: what repeats is taken off, run by run.

Each line of the error's spectrum is divided by the response matrix of a model, and the voltage that
would have made up for it is added. Hysteresis, creep and errors of the model repeat with the path.
"""

from dataclasses import replace

import numpy as np

from piezo_client.scans import Scanned, StoredScan
from piezo_common.arrays import FloatArray
from piezo_models.axes.coupled import CoupledModel

PASSED = 0.1
"""Part of what a stage passes at rest, in its worst direction, down to which a line is learned: up
to three times the highest mode. With 0.03 the errors on the simulated XY stage are the same to a
fifth; further up there is noise, and no model is known."""

SAME_PERIOD = 1e-9
"""Relative difference of sample periods up to which they are one: rounding."""


def learned(run: Scanned, model: CoupledModel) -> StoredScan:
    """Return the scan with voltages that make up for the error of a run.

    The offset stays: creep moves it on.

    Parameters
    ----------
    model : CoupledModel
        Of the same axes, at the sample period of the scan.

    Raises
    ------
    ValueError
        If the model is of other axes or of another sample period.
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
    before = np.arange(-begin, 0) % samples
    return replace(scan, voltage_v=scan.voltage_v + more_v,
                   begin_voltage_v=scan.begin_voltage_v + _rise(begin) * more_v[before])


def _rise(samples: int) -> FloatArray:
    """Return a rise from 0 to 1 of minimum jerk, shape (samples, 1)."""
    at = np.arange(samples)[:, None] / max(samples, 1)
    rise: FloatArray = at**3 * (10.0 + at * (6.0 * at - 15.0))
    return rise
