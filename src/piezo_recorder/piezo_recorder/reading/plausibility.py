# SPDX-License-Identifier: BSD-3-Clause
"""Checks for implausible recordings; they lead to notes, never to a refusal."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezo_common.arrays import FloatArray
from piezo_recorder.reading.recording import Recording


@dataclass(frozen=True)
class UsualStage:
    """Bounds for any piezo stage; values beyond them mean a wrong unit or sensor."""

    least_range_um: float = 0.3
    largest_range_um: float = 3000.0
    """Range of the displacement, from a shear tube to the longest amplified stage."""
    least_swing_v: float = 0.3
    largest_voltage_v: float = 3000.0
    """Swing and magnitude of the voltage; amplifiers for piezos end at 3 kV."""
    least_gain_um_per_v: float = 0.002
    largest_gain_um_per_v: float = 40.0
    """Range over swing: a stack for 1 kV moves a few nm/V, a bender at 60 V some tens of um/V."""
    shortest_period_s: float = 1e-7
    """Sample period; no displacement sensor is faster."""
    fewest_rows: int = 20
    """Number of rows below which a model cannot be fitted."""
    stuck_while: float = 0.03
    """A sensor is clipped if it stays at its end while the voltage moves by this part of its
    range."""
    shortest_clip: int = 5
    """Number of equal readings below which they may be a drop-out of the sensor, unless the voltage
    moves as far as that."""
    stuck_ratio: float = 5.0
    """Largest ratio of the voltage that passes at one value at the end of a sensor's range to that
    elsewhere, and of the number of repetitions of a value at rest."""
    common: float = 0.1
    """Quantile of the distances between readings that is the step of the sensor, as rows that were
    interpolated have values in between."""
    coarse: float = 3e-3
    """Part of the displacement's range; a sensor with larger steps is coarse, not clipped."""
    ahead: float = 0.03
    """Smallest area of a loop relative to its bounding box for which its sense counts; loops of
    stages have 0.05 to 0.2."""
    follows: float = 0.9
    """Smallest correlation of voltage and displacement for which the sense of a loop counts; below
    it, modes may shift the phase by more than 90 degrees."""
    rows_ahead: int = 2
    """Number of rows by which a logger may read the displacement later than the voltage."""


USUAL = UsualStage()


def implausible(recording: Recording) -> list[str]:
    """Return descriptions of what is unusual for any stage."""
    voltage_v, displacement_um = recording.voltage_v, recording.displacement_um
    texts = []
    if len(voltage_v) < USUAL.fewest_rows:
        texts.append(f"there are only {len(voltage_v)} rows: nothing can be identified from them")
    period_s = float(recording.sample_periods_s[0])
    if period_s < USUAL.shortest_period_s:
        texts.append(f"a sample every {period_s:.3g} s is faster than any sensor: is the time in "
                     "days, as spreadsheets keep it, or in minutes?")
    swing_v, range_um = float(np.ptp(voltage_v)), float(np.ptp(displacement_um))
    if swing_v == 0.0:
        texts.append(f"the voltage is {voltage_v[0]:g} V throughout: only noise and drift show")
    if range_um == 0.0:
        texts.append(f"the displacement is {displacement_um[0]:g} um throughout: is the sensor on?")
    if swing_v > 0.0 and range_um > 0.0:
        texts += _beyond_usual(float(np.abs(voltage_v).max()), swing_v, range_um,
                               _followed_um_per_v(voltage_v, displacement_um))
    if swing_v > 0.0 and range_um > 0.0 and runs_ahead(voltage_v, displacement_um):
        texts.append("the displacement runs ahead of the voltage, as if it drove the stage: are "
                     "the two columns exchanged?")
    for name, end, share in clipped_ends(displacement_um, voltage_v):
        texts.append(f"the displacement stays at its {name} value, {end:.6g} um, in "
                     f"{100.0 * share:.2g} % of the samples while it moves elsewhere: the sensor "
                     "is clipped there; reduce the voltage or centre the sensor")
    return texts


def runs_ahead(voltage_v: FloatArray, displacement_um: FloatArray) -> bool:
    """Return whether loops of two signals, (N,), not constant, are impossible for a passive stage.

    With hysteresis, creep and lags the displacement lags behind the voltage, so that loops over
    the voltage are counterclockwise.
    """
    late = USUAL.rows_ahead
    driving, driven = voltage_v[late:], displacement_um[:-late]
    if len(driving) < USUAL.fewest_rows or np.ptp(driving) == 0.0 or np.ptp(driven) == 0.0:
        return False
    if np.corrcoef(driving, driven)[0, 1] < USUAL.follows:
        return False
    driving, driven = ((values - values.min()) / np.ptp(values) for values in (driving, driven))
    area = 0.5 * float(np.sum(driving * np.roll(driven, -1) - np.roll(driving, -1) * driven))
    cycles = max(1.0, 0.5 * float(np.abs(np.diff(driving)).sum()))
    return area < -USUAL.ahead * cycles


def _followed_um_per_v(voltage_v: FloatArray, displacement_um: FloatArray) -> float:
    """Return the slope of the line through the displacement over the voltage, without its sign.

    At a resonance, the displacement follows the voltage out of phase.
    """
    off_v = voltage_v - voltage_v.mean()
    return float(abs(off_v @ displacement_um) / (off_v @ off_v))


def _beyond_usual(largest_v: float, swing_v: float, range_um: float,
                  followed_um_per_v: float) -> list[str]:
    texts = []
    if largest_v > USUAL.largest_voltage_v:
        texts.append(f"the voltage reaches {largest_v:.4g} V, and no amplifier for piezos goes "
                     f"beyond {USUAL.largest_voltage_v:g} V: is it in mV?")
    if swing_v < USUAL.least_swing_v:
        texts.append(f"the voltage changes by {swing_v:.3g} V only: is it in kV, or before the "
                     "amplifier?")
    if range_um < USUAL.least_range_um:
        texts.append(f"the displacement changes by {range_um:.3g} um only: is it in mm, or in "
                     "volts of the sensor?")
    if range_um > USUAL.largest_range_um:
        texts.append(f"the displacement changes by {range_um:.4g} um, more than any piezo stage: "
                     "is it in nm?")
    gain = range_um / swing_v
    if not texts and (gain < USUAL.least_gain_um_per_v
                      or min(gain, followed_um_per_v) > USUAL.largest_gain_um_per_v):
        texts.append(f"{range_um:.4g} um at a swing of {swing_v:.4g} V are {gain:.3g} um/V, which "
                     f"no usual stage has ({USUAL.least_gain_um_per_v:g} to "
                     f"{USUAL.largest_gain_um_per_v:g}): is a unit wrong by 1000?")
    return texts


def clipped_ends(displacement_um: FloatArray, voltage_v: FloatArray,
                 ) -> list[tuple[str, float, float]]:
    """Return the ends of the range at which the sensor is clipped.

    A clipped sensor repeats one value while the voltage moves on, or without its noise. A sensor
    with coarse steps repeats values, too, and is not examined. An end is ``lowest`` or ``highest``,
    with the value there (um), and the part of the samples at it.
    """
    steps_um = np.diff(np.unique(displacement_um))
    step_um = float(np.quantile(steps_um, USUAL.common)) if steps_um.size else np.inf
    if step_um > USUAL.coarse * np.ptp(displacement_um):
        return []
    starts = np.flatnonzero(np.diff(displacement_um, prepend=np.nan) != 0.0)
    lengths = np.diff(np.append(starts, displacement_um.size))
    quantum_v = float(step_um / np.ptp(displacement_um) * np.ptp(voltage_v))
    found = []
    for name, end_um in (("lowest", displacement_um.min()), ("highest", displacement_um.max())):
        at_end = displacement_um[starts] == end_um
        if _is_stuck(voltage_v, starts, lengths, at_end, quantum_v):
            share = float(np.sum(lengths[at_end])) / displacement_um.size
            found.append((name, float(end_um), share))
    return found


def _is_stuck(voltage_v: FloatArray, starts: NDArray[np.intp], lengths: NDArray[np.intp],
              at_end: NDArray[np.bool_], quantum_v: float) -> bool:
    """Return whether the displacement is constant while the voltage moves, or lacks its noise.

    Runs of equal displacements have starts, lengths, and are at the end of the range or not, (M,)
    each. The quantum is the voltage that changes the displacement by its smallest step.
    """
    # The last row may show the displacement from before a jump of its voltage.
    shown_v = np.append(voltage_v[:1], voltage_v[:-1])
    shown_v[starts] = voltage_v[starts]
    moved_v = np.maximum.reduceat(shown_v, starts) - np.minimum.reduceat(shown_v, starts)
    elsewhere_v = max(float(moved_v[~at_end].max(initial=0.0)), quantum_v)
    if np.any(moved_v[at_end] > USUAL.stuck_while * np.ptp(voltage_v)):
        return True
    if np.any(moved_v[at_end & (lengths >= USUAL.shortest_clip)] > USUAL.stuck_ratio * elsewhere_v):
        return True
    # A stage without noise may rest before it first moves; a clipped sensor does so again.
    at_rest = (moved_v == 0.0) & (starts > 0)
    elsewhere = int(lengths[~at_end & at_rest].max(initial=1))
    most = 1 + USUAL.stuck_ratio * (elsewhere - 1)
    return bool(np.any(lengths[at_end & at_rest] > most))
