# SPDX-License-Identifier: BSD-3-Clause
"""A reference from a CSV file."""

import io
import os
import tempfile
from collections.abc import Iterator
from itertools import islice
from typing import BinaryIO, TextIO

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_common.regular_file import UnreadableFile, open_regular
from piezo_controller.references.kind import (
    LONGEST_DURATION_S,
    LONGEST_PERIOD_S,
    InvalidReference,
    Reference,
    Watch,
)
from piezo_controller.references.trajectory import FormulaTrajectory, Trajectory

COLUMNS = ["time_s", "displacement_um"]
LINES_AT_ONCE = 100_000
LONGEST_LINE = 1000
LARGEST_BYTES = 16_000_000_000
"""Largest size of a file; the longest reference takes less than half, with 17 digits per number."""


def read_samples(path: str, sample_rate_hz: float, longest_s: float,
                 watch: Watch | None = None) -> FloatArray:
    """Read a reference that is given at the sample rate, shape (N,).

    The CSV has the columns ``time_s,displacement_um``. The samples are kept in a temporary file
    that is memory-mapped, so a long one takes no memory. Raises ValueError, which names what is
    wrong.
    """
    samples, begin_s = 0, 0.0
    with tempfile.TemporaryFile() as kept:
        for time_s, displacement_um in _pieces(path, watch or (lambda fraction: None)):
            begin_s = begin_s if samples else float(time_s[0])
            expected_s = begin_s + np.arange(samples, samples + time_s.size) / sample_rate_hz
            if np.abs(time_s - expected_s).max() > 0.01 / sample_rate_hz:
                raise ValueError(f"the reference file {path!r} is not sampled at "
                                 f"{sample_rate_hz:g} Hz: resample it to that rate")
            samples += time_s.size
            if samples > longest_s * sample_rate_hz:
                break
            _keep(kept, displacement_um)
        if not 2 <= samples <= longest_s * sample_rate_hz:
            more = "more than " if samples > 2 else ""
            count = int(longest_s * sample_rate_hz) if more else samples
            raise ValueError(f"the reference file {path!r} has {more}{count} samples: give one "
                             f"period of 2 samples to {longest_s:g} s")
        return np.memmap(kept, dtype=float, mode="r", shape=(samples,))


def _keep(kept: BinaryIO, displacement_um: FloatArray) -> None:
    try:
        kept.write(displacement_um.tobytes())
        kept.flush()
    except OSError as error:
        raise ValueError(f"the reference cannot be kept in {tempfile.gettempdir()}: "
                         f"{error.strerror}; let TMPDIR name another directory") from None


def _pieces(path: str, watch: Watch) -> Iterator[FloatArray]:
    """Yield times and displacements of the file, in pieces of some lines."""
    try:
        with open_regular(path, LARGEST_BYTES) as raw, io.TextIOWrapper(
                io.BufferedReader(raw), encoding="utf-8") as stream:
            length, read = max(os.fstat(raw.fileno()).st_size, 1), 0
            header = stream.readline(LONGEST_LINE)
            if [name.strip() for name in header.split(",")] != COLUMNS:
                raise ValueError(f"the reference file {path!r} does not begin with its header: "
                                 f"make the first line {','.join(COLUMNS)}")
            while lines := list(islice(_lines(path, stream), LINES_AT_ONCE)):
                read += sum(map(len, lines))
                watch(min(read / length, 1.0))
                if any(line.strip() for line in lines):
                    yield _numbers(path, lines)
    except UnreadableFile as error:
        raise ValueError(f"the reference file {path!r} {error}: "
                         f"give a CSV file of {','.join(COLUMNS)}") from None
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ValueError(f"the reference file {path!r} cannot be read: {reason}") from None


def _lines(path: str, stream: TextIO) -> Iterator[str]:
    """Yield the lines of a file; each must be of bounded length."""
    while line := stream.readline(LONGEST_LINE):
        if len(line) == LONGEST_LINE:
            raise ValueError(f"the reference file {path!r} has a row of more than {LONGEST_LINE} "
                             f"characters: give {','.join(COLUMNS)} in every row")
        yield line


def _numbers(path: str, lines: list[str]) -> FloatArray:
    try:
        values = np.loadtxt(lines, delimiter=",", comments=None, ndmin=2)
    except ValueError:
        values = np.empty((1, 0))
    if values.shape[1] != len(COLUMNS):
        raise ValueError(f"the reference file {path!r} has a row that is not two numbers: "
                         "give time_s,displacement_um in every row")
    if not np.isfinite(values).all():
        raise ValueError(f"the reference file {path!r} holds a value that is not finite: "
                         "remove or replace it")
    return values.T


class FileKind:
    """A reference from a file: one period, or with `once` a trajectory whose last value is held."""

    def is_periodic(self, reference: Reference, sample_rate_hz: float) -> bool:
        """Return whether the file is one period."""
        return not reference.once

    def period_um(self, reference: Reference, sample_rate_hz: float) -> FloatArray:
        """Read the period."""
        if reference.once:
            raise InvalidReference("a file reference that is not repeated has no period: "
                                   "use a mode that streams it")
        return reference.centre_um + _read(reference, sample_rate_hz, LONGEST_PERIOD_S)

    def trajectory(self, reference: Reference, sample_rate_hz: float, watch: Watch) -> Trajectory:
        """Return the trajectory, which rests at its first and last value, or repeats the period."""
        centre_um, once = float(reference.centre_um), reference.once
        way_um = _read(reference, sample_rate_hz,
                       LONGEST_DURATION_S if once else LONGEST_PERIOD_S, watch)
        last = way_um.size - 1
        return FormulaTrajectory(lambda at: centre_um + way_um[
            np.clip(at, 0, last) if once else at % way_um.size])


def _read(reference: Reference, sample_rate_hz: float, longest_s: float,
          watch: Watch | None = None) -> FloatArray:
    try:
        return read_samples(reference.file, sample_rate_hz, longest_s, watch)
    except ValueError as error:
        raise InvalidReference(str(error)) from None
