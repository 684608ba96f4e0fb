# SPDX-License-Identifier: BSD-3-Clause
"""What an identification is given: checked, its outliers marked, its signs made alike."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from piezo_identification.conditioning.outlier_samples import (
    good_samples,
    outlier_text,
    with_outliers_marked,
)
from piezo_identification.conditioning.row_alignment import rows_read_at_start
from piezo_identification.conditioning.sensor_sign import displacement_falls, reversed_displacement
from piezo_identification.conditioning.waveforms import played, samples_per_mean
from piezo_identification.estimators.frequency_response.response_file import FrequencyResponse
from piezo_recorder.reading.recording import Recording

Data = Recording | FrequencyResponse
"""What the dynamics may be estimated from; all else is a recording."""


def given_data(
    creep: Recording | None, dynamics: Data | None, hysteresis: Recording | None,
    validation: Recording | None, refine: bool,
) -> dict[str, Data]:
    """Name what was given, without what was not.

    Parameters
    ----------
    creep, hysteresis, validation : Recording, optional
    dynamics : Recording or FrequencyResponse, optional
    refine : bool
        All of them are to be simulated.

    Returns
    -------
    dict of str to Recording or FrequencyResponse
        By the name of the experiment.

    Raises
    ------
    ValueError
        If there is no recording of the hysteresis, or one to be simulated is a response.
    """
    if hysteresis is None:
        raise ValueError("there is no recording of the hysteresis: give one")
    if refine and isinstance(dynamics, FrequencyResponse):
        raise ValueError(
            f"{dynamics.path} is a frequency response, which refining cannot simulate: refine "
            "with recordings of samples only"
        )
    named: dict[str, Data | None] = {
        "creep": creep, "dynamics": dynamics, "hysteresis": hysteresis, "validation": validation}
    return {name: data for name, data in named.items() if data is not None}


def with_marked_outliers(
    given: Mapping[str, Data], tell: Callable[[str], object]
) -> dict[str, Data]:
    """Mark the outliers of all recordings, as least squares cannot bear them; tell of them.

    Parameters
    ----------
    given : dict of str to Recording or FrequencyResponse
    tell : callable
        Called with a sentence for each recording that has outliers.

    Returns
    -------
    dict of str to Recording or FrequencyResponse
    """
    marked: dict[str, Data] = {}
    for name, data in given.items():
        if not isinstance(data, FrequencyResponse):
            data = with_outliers_marked(data)
            text = outlier_text(name, ~good_samples(data), data.time_s)
            if text:
                tell(text)
        marked[name] = data
    return marked


def rising_with_voltage(recordings: Mapping[str, Data]) -> dict[str, Any]:
    """Change the sign of all displacements where that of the hysteresis falls with the voltage.

    Parameters
    ----------
    recordings : dict of str to Recording or FrequencyResponse
        With marked outliers.

    Returns
    -------
    dict of str to Recording or FrequencyResponse
    """
    hysteresis = recordings["hysteresis"]
    if isinstance(hysteresis, FrequencyResponse) or not displacement_falls(hysteresis):
        return dict(recordings)
    return {name: reversed_data(data) for name, data in recordings.items()}


def aligned(
    recordings: Mapping[str, Any], read_at_samples: float | Mapping[str, float],
) -> dict[str, Any]:
    """Align the rows of recordings whose displacements are read late; means are left as they are.

    Parameters
    ----------
    recordings : dict of str to Recording or FrequencyResponse
    read_at_samples : float or dict of str to float
        When rows are read, in sample periods after their voltage; of all, or by name.

    Returns
    -------
    dict of str to Recording or FrequencyResponse
    """
    read_at = read_at_samples if isinstance(read_at_samples, Mapping) else dict.fromkeys(
        recordings, read_at_samples)
    return {
        name: data if isinstance(data, FrequencyResponse) or samples_per_mean(played(data)) > 1
        else rows_read_at_start(data, read_at[name])
        for name, data in recordings.items()}


def reversed_data(data: Data) -> Data:
    """Change the sign of measured data: that of a sensor that counts the other way."""
    if isinstance(data, FrequencyResponse):
        return replace(data, gain=-data.gain)
    return reversed_displacement(data)
