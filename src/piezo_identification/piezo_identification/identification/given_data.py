# SPDX-License-Identifier: BSD-3-Clause
"""Conditioning of the data given to an identification: checks, outliers, gaps, signs, and rows."""

from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import replace
from typing import Any

from piezo_identification.conditioning.outlier_samples import (
    good_samples,
    outlier_text,
    with_jump_rows_marked,
    with_outliers_marked,
)
from piezo_identification.conditioning.row_alignment import (
    read_as,
    rows_read_at_start,
    with_straight_voltage,
)
from piezo_identification.conditioning.segments import (
    Recordings,
    experiment_of,
    listed,
    played_segments,
    testable,
)
from piezo_identification.conditioning.sensor_sign import displacement_falls, reversed_displacement
from piezo_identification.estimators.frequency_response.response_file import FrequencyResponse
from piezo_recorder.reading.recording import Recording

Data = Recording | FrequencyResponse
"""Data from which the dynamics may be estimated; all other data are recordings."""


def given_data(
    creep: Recordings | None, dynamics: Recordings | FrequencyResponse | None,
    hysteresis: Recordings | None, validation: Recording | None,
) -> dict[str, Data]:
    """Return the given data by name of the experiment; further ones are numbered: creep, creep 2.

    Raise ValueError if nothing is given to identify.
    """
    if creep is None and dynamics is None and hysteresis is None:
        raise ValueError(
            "there is nothing to identify: give a recording of creep, dynamics or hysteresis")
    named = {"creep": creep, "dynamics": dynamics, "hysteresis": hysteresis,
             "validation": validation}
    result: dict[str, Data] = {}
    for name, data in named.items():
        if isinstance(data, FrequencyResponse):
            result[name] = data
        elif data is not None:
            result |= numbered(name, listed(data))
    return result


def numbered(name: str, data: Iterable[Recording]) -> dict[str, Data]:
    """Name recordings of one kind: creep, creep 2, creep 3."""
    return {name if index == 0 else f"{name} {index + 1}": each
            for index, each in enumerate(data)}


def keys_of_kind(recordings: Mapping[str, Data], name: str) -> list[str]:
    """Return the keys of the recordings of one kind, or of the response in its place."""
    return [key for key in recordings if experiment_of(key) == name]


def of_kind(recordings: Mapping[str, Data], name: str) -> list[Any]:
    """Return the recordings of one kind, or the response in its place, in a list."""
    return [recordings[key] for key in keys_of_kind(recordings, name)]


def conditioned_data(given: Mapping[str, Data], note: Callable[[str], object],
                     read_at_samples: float) -> dict[str, Data]:
    """Mark outliers, cut at gaps, make the displacement rise with the voltage, align the rows.

    Without a recording of the dynamics, the first rows of jumps are marked, too.
    """
    marked = without_gaps(with_marked_outliers(given, note))
    if not of_kind(marked, "dynamics"):
        marked = {name: with_jump_rows_marked(data) for name, data in marked.items()
                  if isinstance(data, Recording)}
    return aligned(rising_with_voltage(marked, note), read_at_samples)


def without_gaps(recordings: Mapping[str, Data]) -> dict[str, Data]:
    """Cut recordings at their gaps, each stretch being a recording; omit a short validation."""
    result: dict[str, Data] = {}
    for name in dict.fromkeys(map(experiment_of, recordings)):
        stretches: list[Any] = []
        for data in of_kind(recordings, name):
            whole = isinstance(data, FrequencyResponse) or not data.gaps
            stretches += [data] if whole else played_segments(data)
        result |= numbered(name, stretches)
    kept = testable(result)
    return {name: data for name, data in result.items()
            if experiment_of(name) != "validation" or name in kept}


def with_marked_outliers(
    given: Mapping[str, Data], note: Callable[[str], object]
) -> dict[str, Data]:
    """Mark the outliers of all recordings, because least squares is sensitive to them."""
    marked: dict[str, Data] = {}
    for name, data in given.items():
        if not isinstance(data, FrequencyResponse):
            data = with_outliers_marked(data)
            text = outlier_text(name, ~good_samples(data), data.time_s)
            if text:
                note(text)
        marked[name] = data
    return marked


def rising_with_voltage(
    recordings: Mapping[str, Data], note: Callable[[str], object],
) -> dict[str, Any]:
    """Change the sign of all displacements if that of the slowest kind of recordings falls."""
    slowest_first = [data for name in ("hysteresis", "creep", "dynamics")
                     for data in of_kind(recordings, name) if isinstance(data, Recording)]
    if not slowest_first or not displacement_falls(slowest_first[0]):
        return dict(recordings)
    note("the displacement falls as the voltage rises: its sign is changed throughout")
    return {name: replace(data, gain=-data.gain) if isinstance(data, FrequencyResponse)
            else reversed_displacement(data) for name, data in recordings.items()}


def with_straight_voltages(recordings: Mapping[str, Data],
                           straight: Collection[str]) -> dict[str, Data]:
    """Return recordings, those named with a voltage that is straight between their rows."""
    return {name: with_straight_voltage(data)
            if name in straight and isinstance(data, Recording) else data
            for name, data in recordings.items()}


def aligned(
    recordings: Mapping[str, Data], read_at_samples: float | Mapping[str, float],
) -> dict[str, Data]:
    """Align the rows of recordings whose displacements are read late; means are not changed.

    The instants, by name or common, are in sample periods after the voltage.
    """
    read_at = read_at_samples if isinstance(read_at_samples, Mapping) else dict.fromkeys(
        recordings, read_at_samples)
    return {
        name: data if isinstance(data, FrequencyResponse)
        else rows_read_at_start(data, read_as(data, read_at[name]))
        for name, data in recordings.items()}
