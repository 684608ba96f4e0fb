# SPDX-License-Identifier: BSD-3-Clause
"""Exclude the beginnings of square waves, where the state of the hysteresis is arbitrary."""

from collections.abc import Mapping

from piezo_identification.conditioning.outlier_samples import without_rows_before
from piezo_identification.conditioning.segments import experiment_of
from piezo_identification.conditioning.waveforms import played, square_part, two_levels
from piezo_identification.estimators.dynamics.fast_estimate import first_used_row
from piezo_identification.estimators.frequency_response.response_file import FrequencyResponse
from piezo_identification.identification.given_data import Data
from piezo_identification.identification.linear_dynamics import LinearDynamics
from piezo_models.hysteresis.preisach import PreisachModel


def without_first_runs(recordings: Mapping[str, Data], linear: LinearDynamics,
                       hysteresis: PreisachModel) -> dict[str, Data]:
    """Exclude the rows of square waves before which the loop was open, as their estimates do.

    These are the creep before its first step if it is off the loop of the later levels, and, if the
    hysteresis is a line, the dynamics before all periods are equal: a line has no open loop.
    """
    used = dict(recordings)
    for name, data in recordings.items():
        if isinstance(data, FrequencyResponse):
            continue
        part = square_part(played(data))
        wave, first = two_levels(part), 0
        if wave is None:
            continue
        if name in linear.estimates and linear.estimates[name].start:
            first = wave.steps[0]
        elif experiment_of(name) == "dynamics" and hysteresis.is_line:
            first = first_used_row(part, wave, linear.creep)
        if first:
            used[name] = without_rows_before(data, part.sample_index[first])
    return used
