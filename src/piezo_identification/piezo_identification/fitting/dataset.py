# SPDX-License-Identifier: BSD-3-Clause
"""The rows of simulated recordings that are fitted, and those of the validation set."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from piezo_common.arrays import BoolArray, FloatArray
from piezo_common.side_by_side import side_by_side
from piezo_identification.conditioning.waveforms import SETTINGS as WAVEFORM
from piezo_identification.fitting.parameter_sensitivities import parameter_sensitivities
from piezo_identification.simulation.past_search import simulated_recording
from piezo_identification.simulation.simulated_recording import PastVoltages, SimulatedRecording
from piezo_models.cascade import StageModel
from piezo_models.effects import Effect, Extent
from piezo_recorder.reading.recording import Recording


@dataclass(frozen=True)
class SplitSettings:
    """How samples are selected, and which of them form the validation set."""

    most_rows: int = 30_000
    """Largest number of samples used, so that a fit to a million samples takes seconds."""
    stretches: int = 120
    """Number of stretches per recording. Each is fitted or held out as a whole, because
    neighbouring errors are correlated. From a longer recording, one chunk of each stretch is used:
    this shows slow and fast errors alike, and a mode that a chirp crosses within a few
    stretches."""
    held_out: int = 3
    """One stretch out of this many is held out."""
    steps: int = 12
    """Largest number of steps from rest whose first rows are used: the first seconds of creep show
    after steps only, which may be rare."""


SPLIT = SplitSettings()

Sensitivities = Callable[[SimulatedRecording, NDArray[np.intp]], FloatArray]


@dataclass(frozen=True, eq=False)
class Dataset:
    """Simulated recordings, the rows of them that are used, and their regressors."""

    model: StageModel
    recordings: tuple[Recording, ...]
    simulated: tuple[SimulatedRecording, ...]

    rows: tuple[NDArray[np.intp], ...]
    """Indices of the samples used in each recording, r in total."""
    stretch: NDArray[np.intp]
    """Number of the stretch that each row belongs to, (r,)."""
    for_estimation: BoolArray
    """Rows that may be fitted, (r,); the others are the validation set."""
    regressors: FloatArray
    """Nuisance regressors of each recording, followed by the parameter sensitivities, in um, (r,
    m)."""
    nuisance_count: int

    extent: Extent
    """Ranges that the recordings cover."""

    def masks(self) -> Iterator[BoolArray]:
        """Yield the mask of the rows of each recording, (r,)."""
        edges = np.cumsum([0, *(rows.size for rows in self.rows)])
        for start, end in zip(edges[:-1], edges[1:], strict=True):
            mask = np.zeros(edges[-1], dtype=bool)
            mask[start:end] = True
            yield mask

    def at_rows(self, signals: Sequence[NDArray]) -> NDArray:
        """Return the values of one signal per recording at the rows, (r,)."""
        return np.concatenate(
            [signal[rows] for signal, rows in zip(signals, self.rows, strict=True)])

    def of_each(self, values: Iterable[float]) -> FloatArray:
        """Return one value per recording, repeated for each of its rows, (r,)."""
        return np.concatenate(
            [np.full(rows.size, value) for value, rows in zip(values, self.rows, strict=True)])

    def difference_um(self, effects: Sequence[Effect] = (),
                      quick: Sequence[Effect] = ()) -> FloatArray:
        """Return measured minus simulated displacement; see `SimulatedRecording.simulate`."""
        return np.concatenate([
            part.measured_um[rows] - part.simulate(effects, quick, rows)
            for part, rows in zip(self.simulated, self.rows, strict=True)])


def simulate_recordings(model: StageModel, recordings: Sequence[Recording],
                        past_v: PastVoltages | None = None,
                        sensitivities: Sensitivities = parameter_sensitivities) -> Dataset:
    """Simulate recordings, and split their samples into rows to fit and a validation set.

    The recordings have the sign of the model and marked outliers. The hysteresis went through the
    voltages `past_v` before each of them, by default those of `starting_past_v`. `sensitivities`
    returns the change of the displacement with each free parameter. Raise ValueError if a recording
    cannot be used.
    """
    simulated = side_by_side(
        lambda recording: simulated_recording(model, recording, past_v), recordings)
    return dataset_of(simulated, recordings, sensitivities)


def dataset_of(simulated: Sequence[SimulatedRecording], recordings: Sequence[Recording],
               sensitivities: Sensitivities = parameter_sensitivities,
               undivided: int = 0) -> Dataset:
    """Split the samples of simulated recordings into rows to fit and a validation set.

    There is at least one recording, and all are simulated with the same model. The measured
    recordings are in the same order, and `sensitivities` is as in `simulate_recordings`. The first
    `undivided` recordings use `SplitSettings.most_rows` each, and the others share that number; by
    default, all share it.
    """
    simulated, model = tuple(simulated), simulated[0].model
    rows, stretch, for_estimation = split_rows(
        [part.voltage_v for part in simulated], [part.begin for part in simulated], undivided)
    nuisance = block_diag(*(
        part.nuisance_regressors(used) for part, used in zip(simulated, rows, strict=True)))
    changes = np.vstack(side_by_side(
        lambda index: sensitivities(simulated[index], rows[index]), range(len(simulated))))
    return Dataset(model, tuple(recordings), simulated, rows, stretch, for_estimation,
                   np.hstack([nuisance, changes]), nuisance.shape[1], _extent(simulated))


def without_recordings(model: StageModel, free: int, extent: Extent) -> Dataset:
    """Return a data set without recordings, for fits of some free parameters to responses alone."""
    return Dataset(model, (), (), (), np.zeros(0, dtype=np.intp), np.zeros(0, dtype=bool),
                   np.zeros((0, free)), 0, extent)


def _extent(simulated: Sequence[SimulatedRecording]) -> Extent:
    """Return the ranges of displacement, voltage, and time that the recordings cover."""
    return Extent(
        max(float(np.ptp(part.measured_um[part.begin :])) for part in simulated),
        min(float(part.voltage_v.min()) for part in simulated),
        max(float(part.voltage_v.max()) for part in simulated),
        max(part.time_s.size * part.sample_period_s for part in simulated),
        min(part.sample_period_s for part in simulated),
    )


def split_rows(voltages_v: Sequence[FloatArray], begins: Sequence[int], undivided: int = 0,
               ) -> tuple[tuple[NDArray[np.intp], ...], NDArray[np.intp], BoolArray]:
    """Return the rows of each recording, the stretch of each row, and whether it may be fitted.

    The voltages of each recording in V are (N,) or (N, axes), and `begins` holds the first sample
    of each that is used. For `undivided` see `dataset_of`. The rows of a recording are (n,), and
    the other two results are (r,) for the rows of all recordings.
    """
    rows, numbers, fitted = [], [], []
    for index, (whole_v, begin) in enumerate(zip(voltages_v, begins, strict=True)):
        budget = max(SPLIT.most_rows // (1 if index < undivided else len(voltages_v)),
                     SPLIT.stretches)
        voltage_v = whole_v[begin:]
        settled = np.arange(begin, len(whole_v))
        is_fitted = np.arange(SPLIT.stretches) % SPLIT.held_out != SPLIT.held_out // 2
        if settled.size > budget:
            # Random shifts keep the chunks from staying in phase with a periodic waveform.
            chunk, room = budget // SPLIT.stretches, settled.size // SPLIT.stretches
            shift = np.random.default_rng(0).integers(0, room - chunk + 1, SPLIT.stretches)
            # Only the beginning shows how far the creep had progressed.
            shift[0] = 0
            first = -(-np.arange(SPLIT.stretches) * settled.size // SPLIT.stretches)
            for number, step in enumerate(_steps_from_rest(voltage_v, chunk)):
                at = int(np.searchsorted(first, step, side="right")) - 1
                length = np.diff(first, append=settled.size)[at]
                shift[at] = min(step - first[at], length - chunk) if at else 0
                if shift[at] < step - first[at] and at + 1 < SPLIT.stretches:
                    shift[at + 1] = 0
                is_fitted[at : at + 2] = (number + 1) % SPLIT.held_out != 0
            starts = begin + first + shift
            chosen = (starts[:, None] + np.arange(chunk)).ravel()
        else:
            chosen = settled
        rows.append(chosen)
        of_rows = (chosen - begin) * SPLIT.stretches // settled.size
        numbers.append(index * SPLIT.stretches + of_rows)
        fitted.append(is_fitted[of_rows])
    return tuple(rows), np.concatenate(numbers), np.concatenate(fitted)


def _steps_from_rest(voltage_v: FloatArray, rest: int) -> NDArray[np.intp]:
    """Return the last rows before voltage steps from rests of some rows, counted from the first."""
    changes_v = np.abs(np.diff(voltage_v, axis=0)).reshape(len(voltage_v) - 1, -1)
    least_v = WAVEFORM.level_tolerance * np.ptp(voltage_v)
    moving = np.flatnonzero(np.any(changes_v > least_v, axis=1))
    steps = moving[np.diff(moving, prepend=-rest) >= rest]
    return steps[:: -(-steps.size // SPLIT.steps) or 1]
