# SPDX-License-Identifier: BSD-3-Clause
"""A reference from a CSV file."""

import csv

import numpy as np

COLUMNS = ["time_s", "displacement_um"]


def read_samples(path, sample_rate_hz, longest_s):
    """Read a reference that is sampled at the sample rate.

    Parameters
    ----------
    path : str
        CSV with the columns ``time_s,displacement_um``.
    sample_rate_hz : float
    longest_s : float

    Returns
    -------
    displacement_um : ndarray, shape (N,)

    Raises
    ------
    ValueError
        Says what is wrong with the file.
    """
    time_s, displacement_um = _read_columns(path)
    if not 2 <= len(time_s) <= longest_s * sample_rate_hz:
        raise ValueError(f"the reference file {path!r} has {len(time_s)} samples: give one "
                         f"period of 2 samples to {longest_s:g} s")
    expected_s = time_s[0] + np.arange(len(time_s)) / sample_rate_hz
    if np.abs(time_s - expected_s).max() > 0.01 / sample_rate_hz:
        raise ValueError(f"the reference file {path!r} is not sampled at "
                         f"{sample_rate_hz:g} Hz: resample it to that rate")
    return displacement_um


def _read_columns(path):
    try:
        with open(path, newline="", encoding="utf-8") as stream:
            rows = list(csv.reader(stream))
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ValueError(f"the reference file {path!r} cannot be read: {reason}") from None
    if not rows or [name.strip() for name in rows[0]] != COLUMNS:
        raise ValueError(f"the reference file {path!r} does not begin with its header: "
                         f"make the first line {','.join(COLUMNS)}")
    try:
        values = np.array([[float(time_s), float(displacement_um)]
                           for time_s, displacement_um in filter(None, rows[1:])])
    except ValueError:
        raise ValueError(f"the reference file {path!r} has a row that is not two numbers: "
                         "give time_s,displacement_um in every row") from None
    if not np.isfinite(values).all():
        raise ValueError(f"the reference file {path!r} holds a value that is not finite: "
                         "remove or replace it")
    return values.reshape(-1, 2).T
