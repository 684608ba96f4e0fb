# SPDX-License-Identifier: BSD-3-Clause
"""Edges of free-running generators, which change their level between the rows of a recording."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_identification.conditioning.generator_edges import (
    EARLY_EDGE,
    INSTANT,
    STEP,
    generator_edges,
)
from piezo_identification.conditioning.waveforms import played, square_part, two_levels
from piezo_identification.simulation.past_search import simulated_recording
from piezo_identification.simulation.simulated_recording import SimulatedRecording
from piezo_models.cascade import StageModel
from piezo_recorder.reading.recording import Recording

ROUNDS = 3
"""Number of linearised fits of the edges; the samples bound their times to a small range."""


def with_generator_edges(model: StageModel, recordings: Sequence[Recording],
                         read_late_s: Sequence[float]) -> list[Recording]:
    """Return recordings, with the column `EARLY_EDGE` where a free-running generator drove them.

    The edges are fitted to the model, with a free gain, offset and initial motion. Those of the
    first such recording keep their mean time, which is indistinguishable from a delay. Recordings
    without such edges, or whose edges explain no more than edges at the rows, are unchanged.

    The recordings have the sign of the model and marked outliers, and the displacement of a row of
    each is read `read_late_s` after its voltage.
    """
    found: list[Recording] = []
    for recording, late_s in zip(recordings, read_late_s, strict=True):
        is_first = not any(EARLY_EDGE in each.columns for each in found)
        found.append(with_edges_of_generator(model, recording, late_s, is_first))
    return found


def _edges_of_rows(recording: Recording) -> tuple[FloatArray, FloatArray] | None:
    """Return early edges, (N,), and their directions, (N, 3), for all rows of a recording."""
    part = square_part(played(recording))
    wave = two_levels(part)
    edges = None if wave is None else generator_edges(wave)
    if edges is None:
        return None
    rows = np.isin(recording.sample_index, part.sample_index)
    early, directions = np.zeros(rows.size), np.zeros((rows.size, edges.directions.shape[1]))
    early[rows], directions[rows] = edges.early, edges.directions
    return early, directions / np.abs(directions).max(axis=0)


def with_edges_of_generator(model: StageModel, recording: Recording, read_late_s: float,
                            keeps_instant: bool) -> Recording:
    """Return one recording as `with_generator_edges` does.

    `keeps_instant` tells whether the edges keep their mean time.
    """
    edges = _edges_of_rows(recording)
    if edges is None:
        return recording
    early, directions = edges
    sampled = simulated_recording(model, recording, read_late_s=read_late_s)
    measured_um = sampled.without_initial_motion(sampled.measured_um)

    def moved(early: FloatArray) -> Recording:
        return replace(recording, columns={**recording.columns, EARLY_EDGE: early})

    def simulated(early: FloatArray) -> SimulatedRecording:
        return simulated_recording(model, moved(early), sampled.past_v, read_late_s)

    def derivative_um(direction: FloatArray) -> FloatArray:
        ahead_um, behind_um = (
            simulated(early + by * direction).simulate() for by in (STEP, -STEP))
        return (ahead_um - behind_um) / (2.0 * STEP)

    for _ in range(ROUNDS):
        signals = [simulated(early).simulate(), *map(derivative_um, directions.T)]
        gain, *by_each = np.linalg.lstsq(
            np.column_stack([sampled.without_initial_motion(each) for each in signals]),
            measured_um, rcond=None)[0]
        if keeps_instant:
            by_each[INSTANT] = 0.0  # what is found is an error of the model's delay
        early = np.clip(early + directions @ by_each / gain, 0.0, 1.0)
    explains_more = simulated(early).error_um() < sampled.error_um()
    return moved(early) if explains_more else recording
