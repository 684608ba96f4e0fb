# SPDX-License-Identifier: BSD-3-Clause
"""A square wave of a generator that runs freely: its edges, fitted beside the dynamics."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_identification.conditioning.generator_edges import GeneratorEdges
from piezo_identification.estimators.dynamics.fast_record import FastRecord, FreeFit
from piezo_identification.estimators.dynamics.fast_signals import FastSignals
from piezo_identification.estimators.dynamics.output_error import ROWS_OF_SEARCH
from piezo_identification.estimators.dynamics.pole_search import free_fits
from piezo_identification.estimators.poles.pole_responses import HeldInput

MODES_TO_DECIDE = 2
"""Modes with which a generator is found to run freely: edges off by half a sample show."""

ROUNDS = 2
"""Fits of the edges, each after one of the poles: either hardly moves the other."""

STEP = 1e-3
"""Part of a sample period of the differences that show what an edge moves."""

INSTANT = 2
"""Direction of `GeneratorEdges` in which all edges move alike."""


def with_edges_between(
    signals: FastSignals, edges: Sequence[GeneratorEdges | None],
) -> FastSignals:
    """Place the edges of generators between the samples, if that leaves less.

    Parameters
    ----------
    signals : FastSignals
        Levels of square waves, as sampled.
    edges : sequence of GeneratorEdges or None
        Of each recording.

    Returns
    -------
    FastSignals
        The same ones where a recording has none, or its edges lie at the samples.
    """
    found = [each for each in edges if each is not None]
    if len(found) < len(edges):
        return signals
    sampled = _free_fit(signals.record())
    directions = np.zeros((signals.entering_um.size, 3 * len(found)))
    for index, (begin, each) in enumerate(zip(signals.begins, found, strict=True)):
        rows = slice(begin, begin + each.early.size)
        directions[rows, 3 * index : 3 * index + 3] = each.directions
    timed = replace(
        signals, early=np.concatenate([each.early for each in found]),
        phase_room=max(each.phase_room for each in found))
    held, left = _fitted_edges(timed.record(), directions)
    return replace(timed, early=held.early) if left < sampled.cost else signals


def _fitted_edges(record: FastRecord, directions: FloatArray) -> tuple[HeldInput, float]:
    """Move the edges to where a fit with free residues leaves least; return what that is."""
    free, held = _free_fit(record), record.input
    assert isinstance(held, HeldInput)
    for _ in range(ROUNDS):
        whole = record.free(free.vector, free.delay)
        moved = edge_responses(held, directions, whole.poles, whole.residues, whole.delay)
        columns = np.column_stack([moved[record.kept], record.fixed])
        by = np.linalg.lstsq(columns, whole.residual, rcond=None)[0][: directions.shape[1]]
        # The instant of the first recording is a delay, which is left to the fit of the poles.
        by[INSTANT] = 0.0
        held = moved_edges(held, directions @ by)
        record = replace(record, input=held)
        free = record.thinned(ROWS_OF_SEARCH).fit_free(free.vector, free.delay)
    return held, free.cost


def moved_edges(held: HeldInput, earlier: FloatArray) -> HeldInput:
    """Move the edges of an input, none of them beyond the samples beside it.

    Parameters
    ----------
    earlier : ndarray, shape (N,)
        Part of a sample period by which each comes earlier; 0 where there is none.
    """
    early = np.zeros_like(held.samples) if held.early is None else held.early
    return replace(held, early=np.clip(early + earlier, 0.0, 1.0))


def edge_responses(
    held: HeldInput, directions: FloatArray, poles: ComplexArray, residues: ComplexArray,
    delay: float,
) -> FloatArray:
    """Differentiate the response of poles by what moves the edges of its input.

    Parameters
    ----------
    directions : ndarray, shape (N, K)
        Parts of a sample period by which each edge comes earlier, in each direction.
    poles, residues : ndarray of complex, shape (n,)
    delay : float
        In sample periods.

    Returns
    -------
    ndarray, shape (N, K)
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
