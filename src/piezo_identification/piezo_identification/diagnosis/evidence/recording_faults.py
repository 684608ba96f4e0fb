# SPDX-License-Identifier: BSD-3-Clause
"""Faults of a recording itself, found before any effect of the stage is sought.

A sensor with the opposite direction, and displacements in the row of another instant, are errors of
the logger. They are corrected and reported, so that no effect has to compensate for them.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal import correlate

from piezo_common.arrays import FloatArray
from piezo_identification.conditioning.outlier_samples import with_outliers_marked
from piezo_identification.conditioning.row_alignment import remaining_delay
from piezo_identification.conditioning.sensor_sign import reversed_displacement, sign_text
from piezo_identification.conditioning.settling import low_frequency_delay_s
from piezo_identification.simulation.past_search import after_saturation
from piezo_identification.simulation.simulated_recording import SimulatedRecording
from piezo_models.cascade import StageModel
from piezo_models.effects.vibration_mode import VibrationMode
from piezo_recorder.reading.recording import Recording

WRONG_SIGN, MISALIGNED_ROWS = "wrong_sign", "misaligned_rows"


@dataclass(frozen=True)
class FaultSettings:
    """When rows are misaligned."""

    most_rows: int = 200
    """Largest shift that is sought."""
    whole: float = 0.1
    """Largest deviation from a shift by whole rows: a logger shifts by whole rows, a stage by any
    time."""
    error_ratio: float = 1.0 / 3.0
    """Largest ratio of the errors on the last third, with and without alignment: causes that only
    resemble a shift reduce the error less."""
    fitted_share: float = 2.0 / 3.0
    """First part of the samples, from which the shift is estimated."""
    as_much_alike: float = 2.0
    """Factor within which two shifts are equivalent; the smallest is used."""
    slow_row: float = 3.0
    """Shortest row, in group delays of the dynamics, for which a late displacement is attributed to
    the logger: in a fast recording the stage may have a delay."""
    slow_turn_rad: float = 0.3
    """Smallest angle by which each mode turns in such a row: a light mode has no group delay."""


SETTINGS = FaultSettings()


@dataclass(frozen=True)
class RecordingFault:
    """A fault of a recording, and how it was corrected."""

    name: str
    """`wrong_sign` or `misaligned_rows`."""
    recording: str
    """Path of the recording."""
    sentence: str
    """Description of the fault."""
    remedy: str
    """What to do before the next recording."""
    numbers: dict[str, float] = field(default_factory=dict)
    """`rows` by which the displacement is late, and the errors on held-out samples."""

    def document(self) -> dict[str, object]:
        """Return its entry in `verdict.json`."""
        return {"name": self.name, "recording": self.recording, "sentence": self.sentence,
                "remedy": self.remedy, **self.numbers}


def without_faults(model: StageModel,
                   recording: Recording) -> tuple[Recording, list[RecordingFault]]:
    """Return a recording with the sign and the rows of the model and its outliers marked.

    Also return the faults that were corrected. Raise ValueError if the recording has gaps, or is
    too short to settle.
    """
    signed = with_outliers_marked(recording)
    run = after_saturation(model, signed)
    is_reversed = run.is_reversed
    if is_reversed:
        # The state fitted with the model would be that of the other sign.
        signed = reversed_displacement(signed)
        run = after_saturation(model, signed)
    rows, is_against = _late_rows(run)
    aligned, fault = _aligned(run, signed, rows, is_against)
    if fault is not None and is_against:
        aligned, is_reversed = reversed_displacement(aligned), not is_reversed
    faults = [*([wrong_sign(recording.path)] if is_reversed else []),
              *([] if fault is None else [fault])]
    return aligned, faults


def wrong_sign(path: object) -> RecordingFault:
    """Return the fault of a recording with the opposite sign of the model's displacement."""
    return RecordingFault(
        WRONG_SIGN, str(path), sign_text(path),
        "if the sensor counts down, change the sign where it is recorded; if the sign of the "
        "voltage was wrong, or the recording is of another axis, record again")


def _aligned(run: SimulatedRecording, recording: Recording, rows: int,
             is_reversed: bool) -> tuple[Recording, RecordingFault | None]:
    """Return the recording with aligned rows if that reduces the error, otherwise unchanged."""
    period_s = run.sample_period_s
    is_slow = _is_slow(run.model, period_s)
    if rows == 0 or rows > 0 and not is_slow:
        return recording, None
    aligned = _read_later(recording, rows)
    before_um, after_um = (
        _error_at_end_um(after_saturation(
            run.model, reversed_displacement(each) if is_reversed else each))
        for each in (recording, aligned))
    if not after_um < SETTINGS.error_ratio * before_um:
        return recording, None
    when = "before" if rows < 0 else "after"
    count = f"{abs(rows)} row{'s' * (abs(rows) != 1)}"
    fault = RecordingFault(
        MISALIGNED_ROWS, str(recording.path),
        f"{recording.path}: the displacement stands {count} {when} the voltage that it answers: "
        f"its rows are aligned, and the error on the last third falls from {1e3 * before_um:.3g} "
        f"to {1e3 * after_um:.3g} nm",
        "write voltage and displacement of one instant into one row",
        {"rows": rows, "before_rms_um": before_um, "after_rms_um": after_um})
    return aligned, fault


def _is_slow(model: StageModel, row_s: float) -> bool:
    """Return whether rows are too slow to show a delay of the stage."""
    modes_rad_per_s = (*model.dynamics.mode_frequencies_rad_per_s, *(
        effect.frequency_rad_per_s for effect in model.effects
        if isinstance(effect, VibrationMode)))
    return (row_s > SETTINGS.slow_row * low_frequency_delay_s(model.dynamics)
            and all(row_s * each > SETTINGS.slow_turn_rad for each in modes_rad_per_s))


def _late_rows(run: SimulatedRecording) -> tuple[int, bool]:
    """Return by how many whole rows the displacement is late, and whether its sign is reversed.

    The number of rows is 0 if the delay is not a whole number of rows.
    """
    used = slice(0, round(SETTINGS.fitted_share * run.settled.size))
    measured_um, simulated_um = (
        signal[used] for signal in (run.measured_um[run.settled], run.fitted_um()))
    rows = _coarse_shift(measured_um, simulated_um)
    against = float(np.sign(_product(measured_um, simulated_um, rows))) or 1.0
    for _ in range(SETTINGS.most_rows):
        late, early = _overlap(measured_um, simulated_um, rows)
        more, deviation = remaining_delay(
            against * late, early, 1.0, np.ones((early.size, 1)))
        if not np.isfinite(deviation) or abs(rows + more) > SETTINGS.most_rows:
            break
        if abs(more) < 0.5:
            is_whole = abs(more) < SETTINGS.whole and deviation < SETTINGS.whole
            return rows if is_whole else 0, against < 0.0
        rows += round(more)
    return 0, against < 0.0


def _coarse_shift(measured_um: FloatArray, simulated_um: FloatArray) -> int:
    """Return the shift with the largest correlation; 0 unless it is clearly larger."""
    centred = [signal - signal.mean() for signal in (measured_um, simulated_um)]
    most = min(SETTINGS.most_rows, measured_um.size // 4)
    shifts = np.arange(-most, most + 1)
    products = correlate(*centred, method="fft")[measured_um.size - 1 + shifts]
    energies = [np.concatenate([[0.0], np.cumsum(signal**2)]) for signal in centred]
    late, early = np.maximum(shifts, 0), np.maximum(-shifts, 0)
    overlap = measured_um.size - np.abs(shifts)
    of_both = [energy[begin + overlap] - energy[begin]
               for energy, begin in zip(energies, (late, early), strict=True)]
    alike = np.abs(products) / np.sqrt(np.maximum(of_both[0] * of_both[1], 1e-300))
    unlike = np.maximum(1.0 - alike, 0.0)  # rounding would make equal signals more than alike
    # A periodic waveform correlates equally well one period later.
    close = np.flatnonzero(unlike <= SETTINGS.as_much_alike * unlike.min())
    best = close[np.argmin(np.abs(shifts[close]))]
    is_clear = unlike[best] < SETTINGS.error_ratio**2 * unlike[most]
    return int(shifts[best]) if is_clear else 0


def _overlap(measured_um: FloatArray, simulated_um: FloatArray,
             rows: int) -> tuple[FloatArray, FloatArray]:
    """Return the overlap of the measured signal, shifted by so many rows, and the simulated one."""
    size = measured_um.size - abs(rows)
    late, early = max(rows, 0), max(-rows, 0)
    return measured_um[late : late + size], simulated_um[early : early + size]


def _product(measured_um: FloatArray, simulated_um: FloatArray, rows: int) -> float:
    late, early = _overlap(measured_um, simulated_um, rows)
    return float((late - late.mean()) @ (early - early.mean()))


def _read_later(recording: Recording, rows: int) -> Recording:
    """Return the recording with the displacement from so many rows later."""
    index = np.arange(recording.displacement_um.size)
    known = (index + rows >= 0) & (index + rows < index.size)
    source = (index + rows)[known]
    of_sensor = dict(_of_sensor(recording, source))
    kept = recording.select(known)
    return replace(kept, displacement_um=recording.displacement_um[source],
                   columns=kept.columns | of_sensor)


def _of_sensor(recording: Recording, source: NDArray[np.intp]) -> Iterator[tuple[str, FloatArray]]:
    """Yield the columns related to the displacement, which are shifted with it."""
    for name, values in recording.columns.items():
        if name.endswith("_um"):
            yield name, values[source]


def _error_at_end_um(run: SimulatedRecording) -> float:
    """Return the RMS error of the last samples, which were not used to estimate the shift."""
    return run.error_um(
        run.good[run.good - run.begin >= SETTINGS.fitted_share * run.settled.size])
