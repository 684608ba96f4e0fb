# SPDX-License-Identifier: BSD-3-Clause
"""When the rows of each recording are read, and the remaining delay of the model."""

from collections.abc import Callable, Collection, Mapping

import numpy as np

from piezo_identification.conditioning.row_alignment import (
    RowDelay,
    away_from_jumps,
    read_as,
    remaining_delay,
)
from piezo_identification.conditioning.waveforms import played
from piezo_identification.estimators.frequency_response.response_file import FrequencyResponse
from piezo_identification.identification.given_data import Data, of_kind
from piezo_identification.identification.linear_dynamics import (
    LinearDynamics,
    aligned_density,
    loop_readings,
)
from piezo_identification.identification.notes import Detail
from piezo_identification.prediction.row_reading import read_as_explained
from piezo_identification.simulation.past_search import after_saturation
from piezo_models.cascade import StageModel
from piezo_recorder.reading.recording import Recording

SHORT_S = 1e-3
"""Delays below this are reported in microseconds."""


def found_readings(recordings: Mapping[str, Data], linear: LinearDynamics) -> dict[str, float]:
    """Return when the rows of each recording are read, in sample periods after the voltage.

    They are read as those of the dynamics. Creep and loops may come from another logger: creep is
    read as in its estimate, loops at the instant from `loop_readings` that fits them best. It is 0
    for means.
    """
    loops_read_at = linear.read_at_samples
    loops = of_kind(recordings, "hysteresis")
    if loops and loop_readings(loops, linear) != {0.0}:
        loops_read_at = aligned_density(loops, linear)[1]
    read_at = {"creep": linear.creep_read_at_samples, "hysteresis": loops_read_at}
    return {name: 0.0 if isinstance(data, FrequencyResponse)
            else read_as(data, read_at.get(name.split()[0], linear.read_at_samples))
            for name, data in recordings.items()}


def validation_as_read(
    model: StageModel, conditioned: Mapping[str, Data], recordings: Mapping[str, Data],
    read_at: Mapping[str, float], some_are_straight: bool = False,
) -> tuple[dict[str, Data], dict[str, float]]:
    """Read the validation as the dynamics only if that reduces its error.

    It may come from another logger, or a logger may read slower rows at another instant. The
    recordings are given as measured, `conditioned`, and aligned.
    """
    read, instants = dict(recordings), dict(read_at)
    for name, data in conditioned.items():
        if name.split()[0] == "validation" and isinstance(data, Recording):
            read[name], instants[name] = read_as_explained(
                model, data, [read_at[name]], some_are_straight)
    return read, instants


def delays_of_rows_s(
    recordings: Mapping[str, Data], read_at: Mapping[str, float],
) -> dict[str, float]:
    """Return the delays of recordings whose rows are not read with their voltage.

    A delay is negative if rows are read late.
    """
    return {name: -read_at[name] * played(data).sample_period_s
            for name, data in recordings.items()
            if not isinstance(data, FrequencyResponse) and read_at.get(name)}


def row_delays(
    model: StageModel, recordings: Mapping[str, Data], found: Mapping[str, float],
    read_at_samples: float, linear: LinearDynamics, straight: Collection[str],
) -> dict[str, RowDelay]:
    """Estimate the remaining delay of each aligned recording, by its name.

    `read_at_samples` is the instant given to `identify`. The voltages of the recordings in
    `straight` are straight between their rows. Frequency responses are omitted.
    """
    rows = {}
    for name, recording in recordings.items():
        if isinstance(recording, FrequencyResponse):
            continue
        read_at = read_as(recording, read_at_samples + found[name])
        estimate = linear.estimates.get(name.split()[0])
        if estimate is not None and estimate.delay is not None:
            delay = estimate.delay
            remaining_s = 0.0 if delay.is_significant else delay.delay_s
            rows[name] = RowDelay(
                read_at, remaining_s, delay.standard_deviation_s, delay.sample_period_s,
                name in straight)
            continue
        run = after_saturation(model, recording)
        kept = ~run.outlier[run.settled] & away_from_jumps(run.voltage_v[run.settled])
        rows[name] = RowDelay(read_at, *remaining_delay(
            run.measured_um[run.settled], run.fitted_um(), run.sample_period_s,
            np.ones((run.settled.size, 1)), kept), run.sample_period_s, name in straight)
    return rows


def report_row_delays(rows: Mapping[str, RowDelay], note: Callable[[str], object]) -> None:
    """Report when the rows of each recording are read, and their remaining delay."""
    for name, row in rows.items():
        is_short = max(abs(row.delay_s), row.standard_deviation_s) < SHORT_S
        scale, unit = (1e6, "us") if is_short else (1.0, "s")
        deviation = f"{scale * row.standard_deviation_s:.2g} {unit}"
        remaining = "a remaining delay is not identifiable from these rows"
        if row.is_significant:
            remaining = f"a delay of {scale * row.delay_s:.3g} +- {deviation} remains"
        elif row.is_identifiable:
            remaining = f"no significant delay remains (+- {deviation})"
        read = (f"read {row.read_at_samples:.4g} sample periods after their voltage"
                if not row.is_straight else "the voltage is taken as straight between them")
        text = f"rows of the {name}: {read}; {remaining}"
        note(text if row.read_at_samples or row.is_straight else Detail(text))
