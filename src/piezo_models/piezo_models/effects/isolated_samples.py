# SPDX-License-Identifier: BSD-3-Clause
"""Find samples that leave a signal and return to it faster than any stage can move."""

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, median_filter

from piezo_common.arrays import FloatArray

Mask = NDArray[np.bool_]
"""One boolean for each sample, shape (N,)."""

AROUND = 25
"""Samples on each side of a step whose steps give the usual size."""

SPREAD = 7.0
"""Limit of a step in standard deviations of the noise of the samples around it."""

STEPS = 2.0
"""Limit of a step in typical steps around it; the tip of a triangle is no larger than one."""

ROUNDINGS, COMMON = 3.0, 0.25
"""Limit of a step in steps of the converter, as its rounding. The converter's step is this quantile
of the distances between values, as rows that were interpolated have values in between."""

ANSWER = 40
"""Samples within which the signal may respond to a step of the voltage, including ringing."""

JUMP, FEWEST_JUMPS = 0.05, 4
"""Fraction of the voltage's range that counts as a jump; fewest jumps to estimate the response."""

ANSWERED = 1.5
"""Largest response to a step of the voltage, relative to the mean gain."""

LENGTHS = (1, 3, 8, 20, 50)
"""Longest runs in samples, tried in this order: of two alternating levels, the shorter runs are
wrong. A run that is longer than all of these is a state of the sensor."""

RETURN = 0.3
"""Fraction of its height within which a run must return to where it began."""

SUDDEN = 0.3
"""Fraction of its height by which a run must begin and end within one sample."""

PREDICTED_FROM, MOST_LEARNT = 8, 20_000
"""Samples on each side from which one is predicted; most examples to fit the prediction."""

AT_THE_ENDS = 3
"""Samples at either end of a signal that may be wrong without a return to it."""

MOST = 0.1
"""Largest fraction of wrong samples; if more stand out, they belong to the signal."""


def isolated(signal: FloatArray, voltage_v: FloatArray, answer_per_v: float | None = None,
             noise: float = 0.0, answered_part: float = 0.0) -> Mask:
    """Mark single samples and short runs that stand out of a signal on both sides, (N,).

    The signal leaves by a step that is large compared with the noise and with the steps around it.
    All samples of the run lie as far from the line between the good neighbours, and the signal
    returns. Steps of the voltage explain steps of the signal for a while. Tips of triangles, edges
    and ringing therefore do not stand out, as the samples next to them move alike.

    `answer_per_v` is the largest change of the signal from one sample to the next per volt of a
    step. By default it is `ANSWERED` times the range of the signal over that of the voltage, or
    less if its responses to jumps of the voltage are slower. `noise` is a lower bound of the
    standard deviation of the signal's noise. Steps of the voltage below the fraction
    `answered_part` of its range explain no step of the signal.
    """
    signal = np.ascontiguousarray(signal, dtype=float)
    voltage_v = np.asarray(voltage_v, dtype=float)
    if signal.size < 2 * AROUND:
        return np.zeros(signal.size, dtype=bool)
    # A residual may move at the ends like the stage; only the signal of a stage has its range.
    has_range = answer_per_v is None
    if answer_per_v is None:
        answer_per_v = typical_answer_per_v(signal, voltage_v)
    changes_v = np.abs(np.diff(voltage_v, prepend=voltage_v[0]))
    changes_v[changes_v < answered_part * typical_range(voltage_v)] = 0.0
    # The window lies before the sample and includes a change at the sample itself.
    answer = answer_per_v * maximum_filter1d(
        changes_v, ANSWER, origin=ANSWER // 2 - 1, mode="nearest")
    good = np.arange(signal.size)
    rest, limits = signal, _limits(signal, answer, noise)
    for longest in LENGTHS:
        for way in (slice(None), slice(None, None, -1)):
            if good.size < 2 * AROUND:
                break
            limit, walk = (each[way] for each in limits)
            if way.step:
                # The limit of a step is stored at its second sample.
                limit = np.roll(limit, 1)
            wrong = _runs(np.ascontiguousarray(rest[way]), np.ascontiguousarray(limit),
                          np.ascontiguousarray(walk), longest)
            if wrong.any():
                good = good[~wrong[way]]
                rest = signal[good]
                limits = _limits(rest, answer[good], noise) if good.size else limits
    wrong = np.ones(signal.size, dtype=bool)
    wrong[good] = False
    wrong = _surprising(signal, wrong, noise)
    if has_range:
        wrong |= _away_at_the_ends(signal, answer)
    if wrong.mean() > MOST:
        return np.zeros(signal.size, dtype=bool)
    return wrong


def typical_answer_per_v(signal: FloatArray, voltage_v: FloatArray) -> float:
    """Estimate the largest change of a signal between samples for a step of 1 V."""
    span_v = typical_range(voltage_v)
    most = ANSWERED * typical_range(signal) / max(span_v, 1e-300)
    changes_v = np.abs(np.diff(voltage_v, prepend=voltage_v[0]))
    jumps = np.flatnonzero(changes_v > JUMP * span_v)
    jumps = jumps[(jumps > 0) & (jumps < signal.size - ANSWER)]
    if span_v == 0.0 or jumps.size < FEWEST_JUMPS:
        return most
    steps = np.abs(np.diff(signal, prepend=signal[0]))
    answers = steps[jumps[:, None] + np.arange(ANSWER)] / changes_v[jumps, None]
    return min(most, STEPS * float(np.median(answers, axis=0).max()))


def typical_range(values: FloatArray) -> float:
    """Return the range of the values without the most extreme 2 % on either side."""
    low, high = np.quantile(values, (0.02, 0.98))
    return float(high - low)


def _away_at_the_ends(signal: FloatArray, answer: FloatArray) -> Mask:
    """Mark up to three first or last samples that are off by more than the signal's usual range."""
    wrong, far = np.zeros(signal.size, dtype=bool), typical_range(signal)
    steps = np.abs(np.diff(signal))
    for count in range(1, AT_THE_ENDS + 1):
        if steps[count - 1] > max(far, answer[count]):
            wrong[:count] = True
        if steps[-count] > max(far, answer[-count]):
            wrong[-count:] = True
    return wrong


def _limits(rest: FloatArray, answer: FloatArray, noise: float) -> tuple[FloatArray, FloatArray]:
    """Return for each sample the largest step of a good signal and the usual change, (N,)."""
    walk = STEPS * _neighbouring(np.abs(np.diff(rest, prepend=rest[0])))
    bends = np.abs(np.diff(rest, 2, prepend=rest[0], append=rest[-1]))
    spread = 1.4826 / np.sqrt(6.0) * _neighbouring(bends)
    apart = np.diff(np.unique(rest))
    rounding = float(np.quantile(apart, COMMON)) if apart.size else 0.0
    return np.maximum.reduce([
        SPREAD * np.maximum(spread, noise), walk, np.full(rest.size, ROUNDINGS * rounding), answer,
    ]), walk


def _surprising(signal: FloatArray, wrong: Mask, noise: float) -> Mask:
    """Keep the runs that the samples around them predict worse than the rest.

    Each sample is predicted from some before and after it, with least-squares weights over all
    samples far from any run. A tone with a period of few samples is therefore predicted, too.
    """
    if not wrong.any():
        return wrong
    around = np.delete(np.arange(-PREDICTED_FROM, PREDICTED_FROM + 1), PREDICTED_FROM)
    inside = np.arange(PREDICTED_FROM, signal.size - PREDICTED_FROM)
    near = maximum_filter1d(wrong, 2 * PREDICTED_FROM + 1)
    usable = inside[~near[inside]]
    if usable.size < 10 * around.size:
        return wrong
    learnt = usable[:: max(1, usable.size // MOST_LEARNT)]
    level = signal[usable].mean()
    weights = np.linalg.lstsq(
        signal[learnt[:, None] + around] - level, signal[learnt] - level, rcond=1e-10)[0]
    filter_ = np.insert(weights, PREDICTED_FROM, -1.0)
    bridged = np.interp(np.arange(signal.size), np.flatnonzero(~wrong), signal[~wrong])
    missed, usual = (
        np.abs(np.convolve(each - level, filter_[::-1], mode="same")) for each in (signal, bridged)
    )
    # There is no prediction at the ends.
    missed[:PREDICTED_FROM] = missed[-PREDICTED_FROM:] = np.inf
    usual[:PREDICTED_FROM] = usual[-PREDICTED_FROM:] = 0.0
    spread = SPREAD * np.maximum(noise, 1.4826 * _neighbouring(usual))
    edges = np.flatnonzero(np.diff(wrong.astype(int), prepend=0, append=0))
    kept = np.zeros(wrong.size, dtype=bool)
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        seen = slice(max(0, begin - 1), end + 1)
        kept[begin:end] = np.any(missed[seen] > spread[seen])
    return kept


def _neighbouring(sizes: FloatArray) -> FloatArray:
    """Return the larger of the median sizes before and after each sample, (N,)."""
    middle = median_filter(sizes, AROUND, mode="reflect")
    # A step belongs to both samples that it joins, so both windows exclude the nearest two.
    away = AROUND // 2 + 2
    before = np.concatenate([np.full(away, middle[0]), middle[:-away]])
    behind = np.concatenate([middle[away:], np.full(away, middle[-1])])
    return np.maximum(before, behind)


@njit(cache=True, nogil=True)
def _runs(signal: FloatArray, limit: FloatArray, walk: FloatArray, longest: int) -> Mask:
    """Mark the runs between a step away and the next sample at which the signal is back."""
    wrong = np.zeros(signal.size, dtype=np.bool_)
    n = 1
    while n < signal.size:
        begin = signal[n - 1]
        if abs(signal[n] - begin) <= limit[n]:
            n += 1
            continue
        end = n
        for back in range(n + 1, min(n + longest + 1, signal.size)):
            last = abs(signal[back] - signal[back - 1])
            if last <= limit[back]:
                continue
            length = back - n + 1
            slope = (signal[back] - begin) / length
            far, farthest = True, 0.0
            for k in range(n, back):
                off = abs(signal[k] - begin - slope * (k - n + 1))
                farthest = max(farthest, off)
                if off <= max(limit[n], limit[back]):
                    far = False
                    break
            returns = abs(signal[back] - begin) <= RETURN * farthest + walk[n] * length
            # The crest of a wave is far off too, but not by its first and last step.
            first = abs(signal[n] - begin)
            if far and returns and min(first, last) >= SUDDEN * farthest:
                end = back
                break
        for k in range(n, end):
            wrong[k] = True
        n = max(end, n) + 1
    return wrong
