# SPDX-License-Identifier: BSD-3-Clause
"""What is implausible about a recording: said to people, never a reason to refuse."""

from dataclasses import dataclass

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_recorder.reading.recording import Recording


@dataclass(frozen=True)
class UsualStage:
    """Bounds that every piezo stage keeps; beyond them a unit or a sensor is wrong.

    Attributes
    ----------
    least_range_um, largest_range_um : float
        Of the displacement: from a shear tube to the longest amplified stage.
    least_swing_v, largest_voltage_v : float
        Of the voltage: amplifiers for piezos end at 3 kV.
    least_gain_um_per_v, largest_gain_um_per_v : float
        Range over swing: a stack for 1 kV moves a few nm/V, a bender at 60 V some tens of um/V.
    shortest_period_s : float
        Of the samples; no sensor of displacement is faster.
    fewest_rows : int
        With fewer there is nothing to fit.
    least_clipped : float
        Part of the samples at an end of the range that count as clipped.
    shortest_clip : int
        Equal samples in a row that count as clipped.
    quanta_in_clip : float
        Quanta of the sensor that the stage should have moved by, in samples that are equal.
    repeated : float
        Part of neighbours that may be equal elsewhere, where those at the end of the range count
        as clipped: a coarse converter repeats everywhere.
    """

    least_range_um: float = 0.3
    largest_range_um: float = 3000.0
    least_swing_v: float = 0.3
    largest_voltage_v: float = 3000.0
    least_gain_um_per_v: float = 0.002
    largest_gain_um_per_v: float = 40.0
    shortest_period_s: float = 1e-7
    fewest_rows: int = 20
    least_clipped: float = 1e-3
    shortest_clip: int = 5
    quanta_in_clip: float = 4.0
    repeated: float = 0.3


USUAL = UsualStage()


def implausible(recording: Recording) -> list[str]:
    """Say what no usual stage does.

    Parameters
    ----------
    recording : Recording

    Returns
    -------
    list of str
        Sentences, without the name of the file.
    """
    voltage_v, displacement_um = recording.voltage_v, recording.displacement_um
    said = []
    if len(voltage_v) < USUAL.fewest_rows:
        said.append(f"there are only {len(voltage_v)} rows: nothing can be identified from them")
    period_s = float(recording.sample_periods_s[0])
    if period_s < USUAL.shortest_period_s:
        said.append(f"a sample every {period_s:.3g} s is faster than any sensor: is the time in "
                    "days, as spreadsheets keep it, or in minutes?")
    swing_v, range_um = float(np.ptp(voltage_v)), float(np.ptp(displacement_um))
    if swing_v == 0.0:
        said.append(f"the voltage is {voltage_v[0]:g} V throughout: only noise and drift show")
    if range_um == 0.0:
        said.append(f"the displacement is {displacement_um[0]:g} um throughout: is the sensor on?")
    if swing_v > 0.0 and range_um > 0.0:
        said += _beyond_usual(float(np.abs(voltage_v).max()), swing_v, range_um)
    for name, end, share in clipped_ends(displacement_um, voltage_v):
        said.append(f"the displacement stays at its {name} value, {end:.6g} um, in "
                    f"{100.0 * share:.2g} % of the samples while it moves elsewhere: the sensor is "
                    "clipped there; reduce the voltage or centre the sensor")
    return said


def _beyond_usual(largest_v: float, swing_v: float, range_um: float) -> list[str]:
    said = []
    if largest_v > USUAL.largest_voltage_v:
        said.append(f"the voltage reaches {largest_v:.4g} V, and no amplifier for piezos goes "
                    f"beyond {USUAL.largest_voltage_v:g} V: is it in mV?")
    if swing_v < USUAL.least_swing_v:
        said.append(f"the voltage changes by {swing_v:.3g} V only: is it in kV, or before the "
                    "amplifier?")
    if range_um < USUAL.least_range_um:
        said.append(f"the displacement changes by {range_um:.3g} um only: is it in mm, or in volts "
                    "of the sensor?")
    if range_um > USUAL.largest_range_um:
        said.append(f"the displacement changes by {range_um:.4g} um, more than any piezo stage: "
                    "is it in nm?")
    gain = range_um / swing_v
    if not said and not USUAL.least_gain_um_per_v <= gain <= USUAL.largest_gain_um_per_v:
        said.append(f"{range_um:.4g} um at a swing of {swing_v:.4g} V are {gain:.3g} um/V, which "
                    f"no usual stage has ({USUAL.least_gain_um_per_v:g} to "
                    f"{USUAL.largest_gain_um_per_v:g}): is a unit wrong by 1000?")
    return said


def clipped_ends(displacement_um: FloatArray, voltage_v: FloatArray,
                 ) -> list[tuple[str, float, float]]:
    """Find the ends of the range at which the sensor is clipped.

    A sensor that is clipped repeats one value, without its noise, where the stage still moves.

    Parameters
    ----------
    displacement_um, voltage_v : ndarray, shape (N,)

    Returns
    -------
    list of (str, float, float)
        ``lowest`` or ``highest``, that value in um, and the part of the samples that stay there.
    """
    found: list[tuple[str, float, float]] = []
    if np.ptp(displacement_um) == 0.0:
        return found
    equal = np.diff(displacement_um) == 0.0
    held = np.diff(voltage_v) == 0.0
    quantum_um = float(np.diff(np.unique(displacement_um)).min())
    um_per_v = float(np.ptp(displacement_um)) / (float(np.ptp(voltage_v)) or np.inf)
    for name, end in (("lowest", displacement_um.min()), ("highest", displacement_um.max())):
        runs = _long_runs(displacement_um == end)
        samples = sum(stop - start for start, stop in runs)
        if samples < USUAL.least_clipped * len(displacement_um):
            continue
        inside = np.zeros(equal.size, dtype=bool)
        for start, stop in runs:
            inside[start : stop - 1] = True
        moves = any(um_per_v * np.ptp(voltage_v[start:stop]) > USUAL.quanta_in_clip * quantum_um
                    for start, stop in runs)
        rests = bool(np.mean(held[inside]) > 0.5)
        elsewhere = equal[(held if rests else ~held) & ~inside]
        noisy = elsewhere.size > USUAL.shortest_clip and elsewhere.mean() < USUAL.repeated
        if noisy and (moves or rests):
            found.append((name, float(end), samples / len(displacement_um)))
    return found


def _long_runs(mask: np.ndarray) -> list[tuple[int, int]]:
    """Return where the runs of a mask that have at least `USUAL.shortest_clip` samples lie."""
    edges = np.flatnonzero(np.diff(mask.astype(np.int8), prepend=0, append=0))
    return [(start, end) for start, end in zip(edges[::2].tolist(), edges[1::2].tolist(),
                                               strict=True) if end - start >= USUAL.shortest_clip]
