# SPDX-License-Identifier: BSD-3-Clause
"""Monitor a stage with a model, and keep its most recent samples for a diagnosis."""

import hashlib
from collections import deque
from dataclasses import dataclass

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_identification.monitoring.model_monitor import ModelMonitor, MonitorSettings, Suspicion
from piezo_identification.monitoring.usual_error import KnownError
from piezo_models.cascade import StageModel
from piezo_recorder.reading.recording import Recording
from piezo_recorder.sample_block import Flag

APPROACH_S = 0.3
"""Time (s) at the start of a run in which the stage approaches its reference and settles."""


@dataclass(frozen=True, eq=False)
class _Piece:
    """Samples of one run, and the voltages in the memory of the hysteresis before them."""

    first_sample: int
    run: int
    past_v: FloatArray
    voltage_v: FloatArray
    displacement_um: FloatArray

    @property
    def end(self) -> int:
        return self.first_sample + self.voltage_v.size


class StageMonitor:
    """Watch the blocks of a stage with a model, in bounded memory.

    Runs of the loop are tested from the end of their approach on; all other samples only update the
    state of the model. After a gap, the model starts anew, as the past of the stage is unknown.
    Raise ValueError if the model or a block is not suitable; see `ModelMonitor`.

    Parameters
    ----------
    kept_s : float
        Duration of the past that is kept for a diagnosis (s).
    rest_voltage_v : float
        Voltage at which the stage rested before the first sample.
    known : KnownError, optional
        Known error of the model; by default, it is unknown and learned during operation.

    Attributes
    ----------
    lost_samples : int
        Number of samples lost in gaps.
    """

    def __init__(self, model: StageModel, sample_rate_hz: float,
                 settings: MonitorSettings | None = None, kept_s: float = 10.0,
                 rest_voltage_v: float = 0.0, known: KnownError | None = None) -> None:
        self._model, self._rest_voltage_v = model, rest_voltage_v
        self.sample_rate_hz = sample_rate_hz
        self._monitor = ModelMonitor(
            model, 1.0 / sample_rate_hz, settings, model.memory(rest_voltage_v), known)
        self._size = self._monitor.block_samples
        self._pieces: deque[_Piece] = deque(
            maxlen=max(2, round(kept_s * sample_rate_hz / self._size)))
        self._waiting: list[tuple[FloatArray, FloatArray]] = []
        self._gathered = 0
        self._next: int | None = None
        self._begin, self._run, self._run_begin = 0, 0, 0
        self._playing = False
        self.lost_samples = 0

    @property
    def is_learning(self) -> bool:
        """Return True until enough blocks were seen to learn the usual error."""
        return self._monitor.is_learning

    @property
    def watched_until_s(self) -> float:
        """Return the time on the sample clock up to which samples were processed."""
        return 0.0 if self._next is None else self._next / self.sample_rate_hz

    def take(self, first_sample: int, sample_period_s: float, voltage_v: FloatArray,
             displacement_um: FloatArray, flags: int) -> list[Suspicion]:
        """Process the next block of samples, and return its alarms, with times on the sample clock.

        `first_sample` is the number of the first sample on that clock. The sample period is longer
        than that of the clock for slow waveforms. Voltage and displacement are (n,), and `flags`
        are the `Flag` bits of the block.
        """
        stride = round(sample_period_s * self.sample_rate_hz)
        if self._next is None or first_sample != self._next:
            self._begin_anew(first_sample)
        self._next = first_sample + stride * len(voltage_v)
        playing = bool(flags & Flag.TRACKING) and not flags & Flag.RAMPING and stride == 1
        if playing != self._playing:
            self._flush()
            self._playing = playing
            if playing:
                self._run, self._run_begin = self._run + 1, first_sample
        if stride > 1:
            self._flush()
            self._monitor.pass_by(np.asarray(voltage_v, dtype=float), sample_period_s)
            self._pieces.clear()
            self._begin = self._next
            return []
        self._waiting.append((np.array(voltage_v), np.array(displacement_um)))
        self._gathered += len(voltage_v)
        raised: list[Suspicion] = []
        while self._gathered >= self._size:
            raised += self._watch(self._size)
        return raised

    def samples_since(self, time_s: float) -> int:
        """Count the kept samples of the last run that were measured since a time (s)."""
        return sum(piece.voltage_v.size for piece in self._since(time_s))

    def recording(self, time_s: float) -> Recording:
        """Return the kept samples of the last run since a time on the sample clock as a recording.

        They are preceded by the voltages in the memory of the hysteresis, flagged as a ramp. Raise
        ValueError if nothing is kept since then.
        """
        pieces = self._since(time_s)
        if not pieces:
            raise ValueError(
                f"no samples of a run are kept since {time_s:g} s: let the stage track")
        past_v = pieces[0].past_v
        measured_um = np.concatenate([piece.displacement_um for piece in pieces])
        voltage_v = np.concatenate([past_v, *(piece.voltage_v for piece in pieces)])
        flags = np.full(voltage_v.size, int(Flag.TRACKING), np.uint32)
        flags[: past_v.size] |= np.uint32(Flag.RAMPING)
        measured_um = np.concatenate([np.full(past_v.size, measured_um[0]), measured_um])
        return Recording(
            f"samples {pieces[0].first_sample} to {pieces[-1].end - 1}", self.sample_rate_hz,
            np.arange(voltage_v.size), np.full(voltage_v.size, 1.0 / self.sample_rate_hz),
            voltage_v, measured_um, flags,
            sha256=hashlib.sha256(voltage_v.tobytes() + measured_um.tobytes()).hexdigest())

    def _since(self, time_s: float) -> list[_Piece]:
        first = round(time_s * self.sample_rate_hz)
        pieces = [piece for piece in self._pieces if piece.first_sample >= first]
        return [piece for piece in pieces if piece.run == pieces[-1].run]

    def _begin_anew(self, first_sample: int) -> None:
        if self._next is not None:
            self.lost_samples += max(0, first_sample - self._next)
        self._waiting, self._gathered = [], 0
        self._pieces.clear()
        self._begin = first_sample
        self._monitor.begin_anew(self._model.memory(self._rest_voltage_v), first_sample)
        self._playing = False

    def _flush(self) -> None:
        """Process the waiting samples that do not fill a block, without testing them."""
        if self._gathered:
            self._pass_by(*self._taken(self._gathered))

    def _watch(self, count: int) -> list[Suspicion]:
        begin = self._begin
        voltage_v, displacement_um = self._taken(count)
        approaching = begin - self._run_begin < APPROACH_S * self.sample_rate_hz
        if not self._playing or approaching:
            self._pass_by(voltage_v, displacement_um)
            return []
        self._keep(voltage_v, displacement_um)
        return self._monitor.watch(voltage_v, displacement_um)

    def _pass_by(self, voltage_v: FloatArray, displacement_um: FloatArray) -> None:
        self._keep(voltage_v, displacement_um)
        self._monitor.pass_by(voltage_v)

    def _keep(self, voltage_v: FloatArray, displacement_um: FloatArray) -> None:
        if self._playing:
            self._pieces.append(_Piece(
                self._begin - voltage_v.size, self._run, self._monitor.past_v, voltage_v,
                displacement_um))

    def _taken(self, count: int) -> tuple[FloatArray, FloatArray]:
        """Remove `count` samples from the waiting ones, and return them."""
        voltage_v, displacement_um = (
            np.concatenate(parts) for parts in zip(*self._waiting, strict=True))
        self._waiting = [(voltage_v[count:], displacement_um[count:])]
        self._gathered -= count
        self._begin += count
        return voltage_v[:count], displacement_um[:count]
