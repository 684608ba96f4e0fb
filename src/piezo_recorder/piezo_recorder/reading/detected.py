# SPDX-License-Identifier: BSD-3-Clause
"""Marks of samples and signals of detectors, which are further columns of a recording."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from piezo_recorder.sample_block import Mark

SIGNAL = "_signal"
"""End of the label of a detector's column, such as ``camera_signal``."""


def marks_in(columns: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the bits of `Mark` in the columns ``pixel``, ``line`` and so on, shape (N,).

    It is empty if there is no such column.
    """
    marks = np.empty(0, np.uint8)
    for mark in Mark:
        if (label := _label(mark)) in columns:
            marks = np.where(columns[label] > 0.0, np.uint8(mark), np.uint8(0)) | (
                marks if marks.size else np.uint8(0))
    return marks


def mark_columns(marks: np.ndarray) -> dict[str, np.ndarray]:
    """Return a column of 0 and 1 for each kind of mark, each of shape (N,)."""
    return {_label(mark): (marks & mark > 0).astype(np.uint8) for mark in Mark}


def signals_in(columns: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return the signals by the names of their detectors, each of shape (N,)."""
    return {label.removesuffix(SIGNAL): column for label, column in columns.items()
            if label.endswith(SIGNAL)}


def is_detected(label: str) -> bool:
    """Return whether a column is of marks or of a detector."""
    return label.endswith(SIGNAL) or label in map(_label, Mark)


def columns_of_blocks(blocks: Sequence[Any], counts: np.ndarray) -> dict[str, np.ndarray]:
    """Return the columns of signals, and of marks if any sample has one; older blocks have neither.

    The counts are the samples of each block.
    """
    names = list(getattr(blocks[0], "signals", ()))
    columns = {}
    if names and all(list(block.signals) == names for block in blocks):
        signal = np.concatenate([block.signal for block in blocks]).reshape(-1, len(names))
        columns = {name + SIGNAL: column for name, column in zip(names, signal.T, strict=True)}
    marks = [np.asarray(getattr(block, "marks", ())) for block in blocks]
    if any(each.size for each in marks):
        columns |= mark_columns(np.concatenate([
            each if each.size else np.zeros(count, np.uint8)
            for each, count in zip(marks, counts, strict=True)]))
    return columns


def _label(mark: Mark) -> str:
    return str(mark.name).lower()
