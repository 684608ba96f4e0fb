# SPDX-License-Identifier: BSD-3-Clause
"""Recordings of one kind as stretches without gaps."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from piezo_recorder.reading.recording import Recording

FEWEST_SAMPLES = 3
"""A stretch between gaps that is shorter tells nothing beside its own offset."""

Recordings = Recording | Sequence[Recording]
"""One recording, or several of one kind."""


def listed(recordings: Recordings) -> tuple[Recording, ...]:
    """Return recordings that may be one or several as a tuple."""
    return (recordings,) if isinstance(recordings, Recording) else tuple(recordings)


def played_segments(recordings: Recordings) -> list[Recording]:
    """Cut recordings into stretches without gaps, of what plays in them.

    What the stage did in a gap is not known, so each stretch begins with an unknown past.

    Parameters
    ----------
    recordings : Recording or sequence of Recording

    Returns
    -------
    list of Recording

    Raises
    ------
    ValueError
        If nothing plays, or no stretch is long enough.
    """
    segments = []
    for recording in listed(recordings):
        part = recording.select(recording.playing | recording.tracking)
        starts = [gap[0] for gap in part.gaps]
        number = np.searchsorted(starts, part.sample_index, side="right")
        stretches = [part.select(number == each) for each in np.unique(number)]
        kept = [replace(each, gaps=[]) for each in stretches
                if each.voltage_v.size >= FEWEST_SAMPLES]
        if not kept:
            raise ValueError(
                f"{recording.path} has fewer than {FEWEST_SAMPLES} samples between its gaps: "
                "record it again")
        segments += kept
    return segments
