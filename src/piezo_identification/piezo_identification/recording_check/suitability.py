# SPDX-License-Identifier: BSD-3-Clause
"""The experiments for which a recording is suitable, and the reasons if it is not."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_identification.analysis.gain_over_frequency import SEGMENTS, gain_of
from piezo_identification.conditioning import waveforms
from piezo_identification.conditioning.segments import Recordings, listed
from piezo_identification.estimators.frequency_response.response_file import FrequencyResponse
from piezo_identification.recording_check.check import (
    FEWEST_ROWS,
    RecordingCheck,
    check_recording,
)
from piezo_identification.recording_check.waveform_kind import Kind

ROWS_FOR_HOLDS = 5000
"""Rows to which a recording is decimated to find holds."""

EXPERIMENTS = ("hysteresis", "creep", "dynamics", "validation")


@dataclass(frozen=True)
class Needs:
    """Requirements of the experiments on a recording."""

    hold_s: float = 2.0
    """Shortest hold of a level that shows creep; the fast creep of stages takes seconds."""
    rows_per_branch: int = 20
    """Fewest rows in a hold from which creep can be estimated, and between reversals for which fast
    cycles show loops, if the dynamics are known."""
    slow_share: float = 0.5
    """Smallest fraction of the time that slow cycles take if faster ones are in the same file."""
    inside: float = 0.1
    """Smallest distance of a reversal of smaller loops from the ends of the voltage, as a fraction
    of its swing."""
    rows_per_ringing: float = 5.0
    """Fewest rows in a period of ringing; with fewer, it may be an alias of a faster one."""
    followed: float = 0.9
    """Fraction of a step that the displacement has completed in the first row after it, above which
    the rows are too slow to show the dynamics."""
    steep_s: float = 2e-3
    steep: float = 0.5
    """Cycles count as steps if they cross the fraction `steep` of their swing within `steep_s`."""
    coherent: float = 0.8
    """Smallest coherence of a line that is used."""
    departs: float = 0.4
    """Smallest relative deviation from the response at the lowest frequency that indicates
    dynamics; creep causes less within a recording."""
    well_visited: float = 0.5
    """Visited fraction of the Preisach plane for which a density is well known."""
    range_over_noise: float = 30.0
    """Smallest range of the displacement over its noise for a suitable recording."""


NEEDS = Needs()


@dataclass(frozen=True)
class Suitability:
    """Suitability of a recording for an experiment."""

    verdict: str
    """``yes``, ``partly`` or ``no``."""
    reason: str


def suitability(check: RecordingCheck) -> dict[str, Suitability]:
    """Return the suitability of a recording by name of the experiment, as in `EXPERIMENTS`."""
    return {name: suitability_for(check, name) for name in EXPERIMENTS}


def suitability_for(check: RecordingCheck, experiment: str) -> Suitability:
    """Return the suitability of a recording for one of `EXPERIMENTS`.

    Only the properties that this experiment needs are computed.
    """
    hindrance = _for_nothing(check)
    if hindrance:
        return Suitability("no", hindrance)
    found = JUDGES[experiment](check)
    if not check.gaps or found.verdict != "yes":
        return found
    if experiment == "validation":
        return Suitability("yes", f"any motion that the others did not have, in {check.gaps + 1} "
                           "segments")
    return Suitability("partly", f"only a segment without one of the {check.gaps} gaps; "
                       f"{found.reason}")


@dataclass(frozen=True)
class Misfit:
    """A recording that is unsuitable for the experiment it was given for."""

    sentence: str
    """Path of the recording and the reason."""
    made_for: tuple[str, ...]
    """Experiments, other than the validation, for which it is suitable."""


def misfits(given: Recordings | FrequencyResponse, experiment: str) -> Iterator[Misfit]:
    """Yield the recordings that are unsuitable for the experiment they were given for.

    A response is not checked.
    """
    for recording in () if isinstance(given, FrequencyResponse) else listed(given):
        check = check_recording(recording)
        fit = suitability_for(check, experiment)
        if fit.verdict == "no":
            yield Misfit(
                f"{recording.path} can hardly stand for the {experiment}: {fit.reason}",
                tuple(other for other in EXPERIMENTS[:-1] if other != experiment
                      and suitability_for(check, other).verdict != "no"))


def given_as(fit_for: Mapping[str, Mapping[str, Suitability]]) -> dict[str, list[str]]:
    """Return the names of the recordings for each experiment, from their suitability by name.

    They are those that are suitable, or else those that are partly suitable; of these, those that
    no experiment before it uses, if there are any. The validation is the first recording that no
    other experiment uses, or else the last one that is not the only one of an experiment. It is
    missing if there is none.
    """
    given: dict[str, list[str]] = {}
    for experiment in EXPERIMENTS[:-1]:
        for verdict in ("yes", "partly"):
            found = [name for name, verdicts in fit_for.items()
                     if experiment in verdicts and verdicts[experiment].verdict == verdict]
            unused = [name for name in found
                      if not any(name in names for names in given.values())]
            if found and experiment not in given:
                given[experiment] = unused or found
    unseen = [name for name, verdicts in fit_for.items()
              if "validation" in verdicts and verdicts["validation"].verdict == "yes"]
    rest = [name for name in unseen if not any(name in names for names in given.values())]
    spare = [name for name in reversed(unseen)
             if all(names != [name] for names in given.values())]
    held_out = (rest or spare)[:1] if given else []
    others = {experiment: [name for name in names if name not in held_out]
              for experiment, names in given.items()}
    return others | ({"validation": held_out} if held_out else {})


def _for_nothing(check: RecordingCheck) -> str:
    """Return why a recording is unsuitable for every experiment; empty if it is not."""
    if len(check.recording.voltage_v) < FEWEST_ROWS:
        return f"{len(check.recording.voltage_v)} rows are too few"
    if check.swing_v == 0.0:
        return "the voltage never changes; it shows noise and drift only"
    if check.range_um == 0.0:
        return "the displacement never changes"
    if check.range_um < NEEDS.range_over_noise * check.noise_um:
        return (f"the displacement moves by {check.range_um:.3g} um in a noise of "
                f"{check.noise_um:.2g} um: drive it further")
    return "the sensor is clipped" if check.is_clipped else ""


def _hysteresis(check: RecordingCheck) -> Suitability:
    waveform = check.waveform
    if waveform.kind is Kind.SQUARE:
        return Suitability("no", "the voltage takes two levels only: give slow cycles")
    rows = waveform.branch_s / check.sample_period_s
    if waveform.branch_s <= waveforms.SETTINGS.slow_branch_s:
        if rows >= NEEDS.rows_per_branch and _has_loops(check) or _has_slow_loops(check):
            return Suitability("partly", f"{waveform.branch_s:.3g} s between most reversals are "
                               "fast: give --dynamics, too, or vibrations and lags count as "
                               "hysteresis")
        return Suitability("no", f"{waveform.branch_s:.3g} s between most reversals are too fast: "
                           "vibrations and lags would count as hysteresis; take several times "
                           f"{waveforms.SETTINGS.slow_branch_s:g} s")
    if not np.any(np.diff(check.recording.voltage_v) < 0.0) or not np.any(
            np.diff(check.recording.voltage_v) > 0.0):
        return Suitability("no", "the voltage goes one way only: give cycles")
    share = check.visited_fraction
    if share < NEEDS.well_visited:
        return Suitability("partly", f"{100.0 * share:.0f} % of the Preisach plane visited, the "
                           "rest would be guessed: let amplitudes rise in small steps")
    return Suitability("yes", f"slow, {100.0 * share:.0f} % of the Preisach plane visited")


def _has_loops(check: RecordingCheck) -> bool:
    """Return whether a voltage has cycles, or is a chirp that visits much of the Preisach plane.

    A chirp of one amplitude shows one loop, but decaying cycles of rising frequency show many.
    """
    kind = check.waveform.kind
    return kind.has_cycles or (
        kind is Kind.CHIRP and check.visited_fraction >= NEEDS.well_visited)


def _has_slow_loops(check: RecordingCheck) -> bool:
    """Return whether slow cycles of several sizes take most of the time, beside faster ones."""
    voltage_v = check.voltage_v
    turns = waveforms.turning_points(
        voltage_v, waveforms.SETTINGS.level_tolerance * check.swing_v)
    branches_s = np.diff(turns) * check.sample_period_s
    is_slow = branches_s > waveforms.SETTINGS.slow_branch_s
    if branches_s[is_slow].sum() < NEEDS.slow_share * branches_s.sum():
        return False
    above, below = voltage_v[turns] - voltage_v.min(), voltage_v.max() - voltage_v[turns]
    is_inside = np.minimum(above, below) > NEEDS.inside * check.swing_v
    return bool(np.any(is_inside[1:-1] & is_slow[:-1] & is_slow[1:]))


def _creep(check: RecordingCheck) -> Suitability:
    hold_s = _hold_s(check)
    if hold_s == 0.0 and NEEDS.hold_s <= check.waveform.branch_s < np.inf:
        return Suitability("partly", "no level is held, so creep shows only in how far loops open: "
                           "a square wave or steps of minutes show more")
    if hold_s == 0.0:
        return Suitability("no", "no level is held: give a square wave or steps of minutes")
    if hold_s < NEEDS.hold_s:
        return Suitability("no", f"levels are held for {hold_s:.3g} s only: hold them "
                           f"for {NEEDS.hold_s:g} s at least, better for minutes")
    rows = hold_s / check.sample_period_s
    if rows < NEEDS.rows_per_branch:
        return Suitability("no", f"a hold has {rows:.0f} rows only: record faster")
    if not check.starts_settled:
        return Suitability("partly", "it does not begin at rest: its first level shows the creep "
                           "of earlier voltages")
    return Suitability("yes", f"levels held for {hold_s:.4g} s, for poles from about "
                       f"{1.0 / hold_s:.2g} rad/s up")


def _hold_s(check: RecordingCheck) -> float:
    """Return how long levels are held between jumps or ramps; 0 if there are no holds."""
    waveform = check.waveform
    if waveform.kind.has_levels:
        return waveform.branch_s
    if not NEEDS.hold_s <= waveform.branch_s < np.inf:
        return 0.0
    step = 1 + check.voltage_v.size // ROWS_FOR_HOLDS
    voltage_v, width_v = check.voltage_v[::step], waveforms.SETTINGS.level_tolerance * check.swing_v
    holds, begin = [], 0
    while begin < voltage_v.size:
        away = np.abs(voltage_v[begin:] - voltage_v[begin]) > width_v
        rows = int(np.argmax(away)) if away.any() else away.size
        holds.append(rows * step * check.sample_period_s)
        begin += max(rows, 1)
    # With slow rows, a few equal ones are not a hold.
    least_s = max(NEEDS.hold_s, NEEDS.rows_per_branch * check.sample_period_s)
    long_s = [hold_s for hold_s in holds if hold_s >= least_s]
    # A slow sine stays at its ends for less.
    least_held_s = waveforms.SETTINGS.held_rows * check.duration_s
    return float(np.median(long_s)) if sum(long_s) > least_held_s else 0.0


def _dynamics(check: RecordingCheck) -> Suitability:
    found = _motion_with_dynamics(check)
    if found.verdict == "no" or check.sample_period_s <= waveforms.SLOWEST_FAST_ROWS_S:
        return found
    return Suitability("partly", "too slow for a piezo stage, which answers within milliseconds: "
                       f"anything faster is folded into {found.reason}")


def _motion_with_dynamics(check: RecordingCheck) -> Suitability:
    waveform = check.waveform
    rate = f"at {round(1.0 / check.sample_period_s, 4):g} rows a second"
    voltage_v, displacement_um = check.voltage_v, check.displacement_um
    if waveform.kind.has_levels:
        response = jump_response(voltage_v, displacement_um, waveform.jumps)
        if response.size < 4:
            return Suitability("no", f"too few rows behind each step {rate}: record faster")
        # The row of the jump itself may be measured before or after the step.
        after = response[1:3]
        if after.min() > NEEDS.followed and abs(response[1:].max() - 1.0) < 1.0 - NEEDS.followed:
            return Suitability("no", f"too slow to hold dynamics: {rate} the displacement has "
                               f"followed each step by {100.0 * after.min():.0f} % in one row; "
                               "record at least ten times faster than the highest mode")
        ringing = rows_per_ringing(response)
        if ringing < NEEDS.rows_per_ringing:
            return Suitability("partly", f"{rate} what rings behind the steps has {ringing:.1f} "
                               "rows in a period, and may be something faster, folded: record at "
                               "least ten times faster than the highest mode")
        return Suitability("yes", f"steps that ring or lag over several rows, {rate}")
    if not waveform.kind.is_broadband and not _is_steep(check):
        jumps = waveform.jumps.size
        if jumps:
            return Suitability("partly", f"{jumps} jump{'s' if jumps > 1 else ''} among slow "
                               "motion: cut the file around them")
        return Suitability("no", f"the voltage ({waveform.kind}) is too slow to excite vibrations: "
                           "give steps, a chirp, a multisine or noise")
    frequency_hz, departure = _departure(check)
    if departure < NEEDS.departs:
        return Suitability("no", f"shows no dynamics: {rate} the displacement follows the voltage "
                           "at every frequency as it does slowly; give a voltage that reaches the "
                           "modes, and rows at least ten times faster")
    return Suitability("yes", f"{waveform.kind} that the displacement follows with dynamics, "
                       f"{rate}; the response differs from the slowest most at "
                       f"{frequency_hz:.4g} Hz")


def _is_steep(check: RecordingCheck) -> bool:
    """Return whether cycles cross most of the swing at once, like steps through an amplifier."""
    if check.waveform.kind is not Kind.CYCLES or check.waveform.jumps.size:
        return False
    rows = max(1, round(NEEDS.steep_s / check.sample_period_s))
    crossed_v = np.abs(check.voltage_v[rows:] - check.voltage_v[:-rows])
    return bool(crossed_v.max(initial=0.0) > NEEDS.steep * check.swing_v)


def _validation(check: RecordingCheck) -> Suitability:
    return Suitability("yes", "any motion that the others did not have")


JUDGES = {"hysteresis": _hysteresis, "creep": _creep, "dynamics": _dynamics,
          "validation": _validation}


def jump_response(voltage_v: FloatArray, displacement_um: FloatArray,
                  jumps: np.ndarray) -> FloatArray:
    """Return the mean response to steps, scaled to 0 before the step and 1 at the end of the hold.

    The voltage changes its level at the samples `jumps`. The response, (M,), begins with the sample
    of the jump, and has up to 200 samples or a usual hold.
    """
    edges = np.append(jumps, len(voltage_v))
    holds = np.diff(edges)
    length = int(min(np.median(holds), 200)) if holds.size else 0
    weighted, weight = np.zeros(length), 0.0
    for jump, hold in zip(jumps.tolist(), holds.tolist(), strict=True):
        if hold < length or length < 4 or jump < 2:
            continue
        before_um = displacement_um[max(jump - 3, 0) : jump].mean()
        end_um = np.median(displacement_um[jump + length // 2 : jump + length])
        step_v = voltage_v[jump] - voltage_v[jump - 1]
        # Weight by the step, so that small ones, which are mostly noise, count little.
        weighted += step_v * (displacement_um[jump : jump + length] - before_um)
        weight += step_v * (end_um - before_um)
    return weighted / weight if weight else np.zeros(0)


def rows_per_ringing(response: FloatArray) -> float:
    """Return the rows in a period of the strongest ringing in a `jump_response`; else infinity."""
    changes = np.diff(response[1:])
    if changes.size < 4:
        return np.inf
    strength = np.abs(np.fft.rfft(changes, 8 * changes.size))
    top = int(np.argmax(strength))
    # Lag and creep are monotonic, so the spectrum of their changes is largest at 0 Hz.
    return 8.0 * changes.size / top if top > 8 else np.inf


def _departure(check: RecordingCheck) -> tuple[float, float]:
    """Return the largest relative deviation of the response from that at the lowest frequency.

    All coherent lines are used, however small their power: steps over the whole range excite the
    modes with a millionth of their power. Modes, lags and delays change the response; hysteresis
    and creep hardly do. Returned are the frequency in Hz and the deviation.
    """
    segment = max(16, check.voltage_v.size // SEGMENTS)
    frequency_hz, response, coherence = gain_of(
        check.voltage_v, check.displacement_um, check.sample_period_s, segment, least_power=0.0)
    coherent = coherence > NEEDS.coherent
    frequency_hz, response = frequency_hz[coherent], response[coherent]
    if response.size < 2:
        return 0.0, 0.0
    departure = np.abs(response / response[0] - 1.0)
    most = int(np.argmax(departure))
    return float(frequency_hz[most]), float(departure[most])
