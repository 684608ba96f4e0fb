# SPDX-License-Identifier: BSD-3-Clause
"""Edges of the square wave of a free-running generator, fitted together with the dynamics."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_identification.conditioning.generator_edges import INSTANT, STEP, GeneratorEdges
from piezo_identification.estimators.dynamics.fast_record import FastRecord, FreeFit
from piezo_identification.estimators.dynamics.output_error import ROWS_OF_SEARCH
from piezo_identification.estimators.dynamics.pole_search import free_fits
from piezo_identification.estimators.poles.pole_responses import HeldInput

MODES_TO_DECIDE = 2
"""Number of modes with which a free-running generator is detected, as edges off by half a sample
show, and a line is compared with a hysteresis."""

ROUNDS = 2
"""Number of fits of the edges, each after one of the poles: they hardly affect each other."""


def with_edges_between(
    record: FastRecord, edges: Sequence[GeneratorEdges | None],
) -> FastRecord:
    """Place the edges of generators between the samples if that reduces the error.

    The input of the record is the levels of square waves, as sampled. The same record is returned
    if a recording has no edges, or if its edges lie at the samples.
    """
    found = [each for each in edges if each is not None]
    held = record.input
    assert isinstance(held, HeldInput)
    if len(found) < len(edges):
        return record
    sampled = _free_fit(record)
    directions = np.zeros((held.samples.size, 3 * len(found)))
    for index, (begin, each) in enumerate(zip(held.begins, found, strict=True)):
        rows = slice(begin, begin + each.early.size)
        directions[rows, 3 * index : 3 * index + 3] = each.directions
    timed = replace(
        record, input=replace(held, early=np.concatenate([each.early for each in found])),
        phase_room=max(each.phase_room for each in found))
    moved, cost_then = _fitted_edges(timed, directions)
    return replace(timed, input=moved) if cost_then < sampled.cost else record


def _fitted_edges(record: FastRecord, directions: FloatArray) -> tuple[HeldInput, float]:
    """Move the edges to minimise the error of a fit with free residues; return it as well."""
    free, held = _free_fit(record), record.input
    assert isinstance(held, HeldInput)
    for _ in range(ROUNDS):
        whole = record.free(free.vector, free.delay)
        moved = edge_responses(held, directions, whole.poles, whole.residues, whole.delay)
        columns = np.column_stack([moved[record.kept], record.fixed])
        by = np.linalg.lstsq(columns, whole.residual, rcond=None)[0][: directions.shape[1]]
        # The instant of the first recording is a delay, which the fit of the poles determines.
        by[INSTANT] = 0.0
        held = moved_edges(held, directions @ by)
        record = replace(record, input=held)
        free = record.thinned(ROWS_OF_SEARCH).fit_free(free.vector, free.delay)
    return held, free.cost


def moved_edges(held: HeldInput, earlier: FloatArray) -> HeldInput:
    """Move the edges of an input, but not beyond the adjacent samples.

    Each edge is moved earlier by a fraction of a sample period, (N,), which is 0 where there is
    none.
    """
    early = np.zeros_like(held.samples) if held.early is None else held.early
    return replace(held, early=np.clip(early + earlier, 0.0, 1.0))


def edge_responses(
    held: HeldInput, directions: FloatArray, poles: ComplexArray, residues: ComplexArray,
    delay: float,
) -> FloatArray:
    """Differentiate the response of poles, (n,), by displacements of the edges of its input.

    Each direction, a column of (N, K), is the fraction of a sample period by which each edge is
    earlier. The delay is in sample periods. The result is (N, K).
    """
    assert held.early is not None
    columns = []
    for direction in directions.T:
        step = STEP / np.abs(direction).max()
        ahead, behind = (
            replace(held, early=held.early + by * direction).responses(poles, delay).value
            for by in (step, -step))
        columns.append(((ahead - behind) @ residues).real / (2.0 * step))
    return np.column_stack(columns)


def _free_fit(record: FastRecord) -> FreeFit:
    return min(free_fits(record.thinned(ROWS_OF_SEARCH), MODES_TO_DECIDE),
               key=lambda fit: fit.cost)
