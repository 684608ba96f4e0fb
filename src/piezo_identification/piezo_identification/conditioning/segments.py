# SPDX-License-Identifier: BSD-3-Clause
"""Recordings of one kind as stretches without gaps."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from piezo_identification.conditioning.waveforms import SETTINGS as WAVEFORM
from piezo_recorder.reading.recording import Recording

FEWEST_SAMPLES = 3
"""Fewest samples of a stretch between gaps that determines more than its own offset."""

FEWEST_TO_TEST = 30
"""Fewest samples of a stretch to test a model; a shorter one depends mostly on its unknown past."""

Recordings = Recording | Sequence[Recording]
"""One recording, or several of one kind."""


def listed(recordings: Recordings) -> tuple[Recording, ...]:
    """Return one recording or several as a tuple."""
    return (recordings,) if isinstance(recordings, Recording) else tuple(recordings)


def experiment_of(name: str) -> str:
    """Return the experiment of a recording without its number: "creep" for "creep 2"."""
    return name.split()[0]


def testable(recordings: Mapping[str, Any]) -> dict[str, Any]:
    """Return the data on which a model can be tested, by name of the experiment.

    Further recordings are numbered: creep, creep 2. Short stretches are left out, unless an
    experiment has no others.
    """
    def is_long(data: Any) -> bool:
        return not isinstance(data, Recording) or data.voltage_v.size >= FEWEST_TO_TEST

    with_long = {experiment_of(name) for name, data in recordings.items() if is_long(data)}
    return {name: data for name, data in recordings.items()
            if is_long(data) or experiment_of(name) not in with_long}


def played_segments(recordings: Recordings) -> list[Recording]:
    """Divide recordings into stretches without gaps in which a waveform is played.

    The motion in a gap is unknown, so each stretch begins with an unknown past. Stretches in which
    the voltage rests show only noise and drift, and are omitted. Raise ValueError if no waveform is
    played, or no stretch is long enough.
    """
    segments = []
    for recording in listed(recordings):
        part = recording.select(recording.playing | recording.tracking)
        starts = [gap[0] for gap in part.gaps]
        number = np.searchsorted(starts, part.sample_index, side="right")
        stretches = [part.select(number == each) for each in np.unique(number)]
        least_v = WAVEFORM.level_tolerance * np.ptp(part.voltage_v) if part.voltage_v.size else 0.0
        kept = [replace(each, gaps=[]) for each in stretches
                if each.voltage_v.size >= FEWEST_SAMPLES and np.ptp(each.voltage_v) >= least_v]
        if not kept:
            raise ValueError(
                f"{recording.path} has fewer than {FEWEST_SAMPLES} samples between its gaps while "
                "the voltage moves: record it again")
        segments += kept
    return segments


def voltage_range_v(parts: Sequence[Recording]) -> tuple[float, float]:
    """Return the lowest and highest voltage of recordings.

    Raise ValueError if the voltage does not change.
    """
    lowest_v = min(part.voltage_v.min() for part in parts)
    highest_v = max(part.voltage_v.max() for part in parts)
    if lowest_v == highest_v:
        raise ValueError(
            f"the voltage of {parts[0].path} is {lowest_v:g} V throughout: give a recording in "
            "which it moves")
    return lowest_v, highest_v


def longest_stretch(recording: Recording) -> tuple[Recording, list[str]]:
    """Return the longest stretch between the gaps of a recording, and a message about it.

    It is the recording itself, without a message, if it has no gaps while a waveform is played. For
    what it raises see `played_segments`.
    """
    part = recording.select(recording.playing | recording.tracking)
    if not part.gaps:
        return recording, []
    longest = max(played_segments(recording), key=lambda each: each.voltage_v.size)
    return longest, [
        f"{recording.path} has {len(part.gaps)} gaps: its longest part between them is simulated, "
        f"samples {longest.sample_index[0]} to {longest.sample_index[-1]}, "
        f"{longest.voltage_v.size} of {part.voltage_v.size}"]
