# SPDX-License-Identifier: BSD-3-Clause
"""Which samples of the recordings are fitted, which judge, and how contributions look to a fit."""

import numpy as np

MOST_ROWS = 30_000
"""Samples that are fitted and judged, in chunks spread evenly over longer recordings."""
CHUNK = 250
STRETCHES, HELD_OUT = 120, 3
"""Stretches of a recording, and which of them are held out: one in three."""


def stretches(prepared):
    """Choose the rows of each recording, and those that are fitted.

    Parameters
    ----------
    prepared : list of PreparedRecording

    Returns
    -------
    rows : list of array of int
        Samples of each recording.
    stretch : (n,) array of int
        Of every row.
    fitted : (n,) array of bool
        The others judge.
    """
    budget = MOST_ROWS // len(prepared)
    rows, numbers = [], []
    for index, part in enumerate(prepared):
        settled = np.arange(part.begin, part.time_s.size)
        if settled.size > budget:
            # Chunks that do not keep step with a periodic waveform.
            chunks = budget // CHUNK
            room = settled.size // chunks
            shift = np.random.default_rng(0).integers(0, room - CHUNK + 1, chunks)
            starts = part.begin + np.arange(chunks) * room + shift
            chosen = (starts[:, None] + np.arange(CHUNK)).ravel()
        else:
            chosen = settled
        rows.append(chosen)
        numbers.append(index * STRETCHES + (chosen - part.begin) * STRETCHES // settled.size)
    stretch = np.concatenate(numbers)
    return rows, stretch, stretch % HELD_OUT != HELD_OUT // 2


def views(columns, prior, rows, tolerance_um, difference_um):
    """How much a contribution takes off what free and tuning columns leave, and how much shows.

    Parameters
    ----------
    columns : (n, m) array
        Of the rows, over the tolerance.
    prior : (p, m) array
    rows : (n,) array of int
    tolerance_um : float
    difference_um : (N,) array
        Measured minus simulated.

    Returns
    -------
    reduction, visible : callable
        Of `piezo_models.effects.effect.Evidence`.
    """
    q, _ = np.linalg.qr(np.vstack([columns, prior]))

    def project(values):
        zeros = np.zeros((len(prior), values.shape[1]))
        padded = np.vstack([values[rows] / tolerance_um, zeros])
        return padded - q @ (q.T @ padded)

    left = project(difference_um[:, None])[:, 0]
    energy = left @ left

    def reduction(contributions):
        seen = project(contributions)
        gains = np.linalg.lstsq(seen, left, rcond=1e-10)[0]
        rest = left - seen @ gains
        return gains, 1.0 - (rest @ rest) / energy

    def visible(contribution):
        varying = (contribution[rows] - contribution[rows].mean()) / tolerance_um
        return np.linalg.norm(project(contribution)) / max(np.linalg.norm(varying), 1e-300)

    return reduction, visible
