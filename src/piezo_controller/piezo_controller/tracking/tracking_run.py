# SPDX-License-Identifier: BSD-3-Clause
"""One run of the loop: answers every block, and computes the tracking error."""

import math
import time
from collections import deque

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_controller.feedforward.plan import TrackingPlan
from piezo_controller.references.smooth_rise import smooth_rise
from piezo_controller.tracking.feedbacks import Feedback
from piezo_controller.tracking.foreseen import SHARE_AT_REST
from piezo_controller.tracking.on_target import OnTarget

USUAL_PERCENT = 99
TOLERANCE_OF_TRAVEL, LEAST_TOLERANCE_UM = 0.01, 0.03
NOT_FOLLOWED = "the stage did not follow the reference"
"""Beginning of the note for a run whose error is that of a stage at rest."""

BOUNDS_S = np.geomspace(1e-6, 100.0, 161)
"""Bounds of the histogram (s), twenty per decade: a percentile is exact to 12 %."""


class AnswerTimes:
    """Histogram of computing times, which takes the same memory for a run of any length.

    Answers that take longer than the limit are late.
    """

    def __init__(self, limit_s: float) -> None:
        self._limit_s = limit_s
        self._counts = np.zeros(BOUNDS_S.size + 1, dtype=np.int64)
        self.count = self.late = 0

    def add(self, time_s: float) -> None:
        """Count one answer."""
        self.count += 1
        self.late += time_s > self._limit_s
        self._counts[np.searchsorted(BOUNDS_S, time_s)] += 1

    def percentile_s(self, percent: float) -> float:
        """Return the bound (s) within which that percentage of the answers came.

        It is infinite beyond the last bound.
        """
        reached = np.searchsorted(np.cumsum(self._counts), percent / 100 * self.count)
        return float(np.append(BOUNDS_S, np.inf)[reached])



class TrackingRun:
    """Follow a plan block by block.

    Parameters
    ----------
    run_samples : int
        Duration for which the reference is followed after the approach; the error is evaluated
        here.
    feedback : Feedback, optional
        Answers the blocks; None if only the feedforward acts.
    tick_s : float
        Period of the feedback (s).
    tolerance_um : float
        The displacement is on target if its rms error over 10 ms at 40 kHz is at most this (um);
        0 for 1 % of the travel, but at least 0.03 um.
    window_samples : int
        Window of the running error.
    fade_s : float
        Time over which the error at the start of the feedback is faded in (s), see `FeedbackLaw`.

    Attributes
    ----------
    expected_um : ndarray, shape (n,)
        Reference of the last block, up to the end of the run.
    """

    def __init__(self, plan: TrackingPlan, run_samples: int, feedback: Feedback | None = None,
                 tick_s: float = 1e-3, tolerance_um: float = 0.0,
                 window_samples: int = 4000, fade_s: float = 0.0) -> None:
        self._plan = plan
        self._fade_s = fade_s
        self._last_error_um = self._initial_um = math.nan
        self._answers_from: int | None = None
        self._tick_s = tick_s
        self._answer_times = AnswerTimes(tick_s)
        self._feedback = feedback
        self._run_samples = run_samples
        self._planned_travel_um = plan.travel_um(run_samples)
        self._lowest_um, self._highest_um = math.inf, -math.inf
        self.tolerance_um = tolerance_um or max(
            TOLERANCE_OF_TRAVEL * self._planned_travel_um, LEAST_TOLERANCE_UM)
        self.samples = 0
        self.expected_um: FloatArray = np.empty(0)
        self._squares, self._counted = 0.0, 0
        self._expected_sum = self._expected_squares = 0.0
        self.largest_error_um = math.nan
        self._window = RunningSquares(window_samples)
        self._target = OnTarget(self.tolerance_um)

    @property
    def total_samples(self) -> int:
        """Return the samples of the approach and of the part that counts."""
        return self._plan.begin_sample + self._run_samples

    @property
    def complete(self) -> bool:
        """Return whether all samples that count have been taken."""
        return self.samples >= self.total_samples

    @property
    def begun(self) -> bool:
        """Return whether a sample that counts has been taken."""
        return self._counted > 0

    @property
    def fraction(self) -> float:
        """Return the fraction of the run that is done (0 to 1)."""
        return min(1.0, self.samples / self.total_samples)

    @property
    def on_target(self) -> bool:
        """Return whether the error is within the tolerance now."""
        return self._target.since_sample is not None

    @property
    def settled_after_sample(self) -> float:
        """Return the sample of the counted part from which on the error was within the tolerance.

        It is NaN if the error is not within the tolerance now.
        """
        since_sample = self._target.since_sample
        return math.nan if since_sample is None else since_sample

    def take(self, displacement_um: FloatArray) -> float:
        """Take the displacements of the next block, shape (n,), and return the answer to it (V).

        It is zero without feedback, and before it begins.
        """
        first, total = self.samples, self.total_samples
        self.samples += len(displacement_um)
        displacement_um = displacement_um[:max(total - first, 0)]
        if not len(displacement_um):
            self.expected_um = np.empty(0)
            return 0.0
        expected_um = self.expected_um = self._plan.expected_um(first, len(displacement_um))
        self._account(max(self._plan.begin_sample - first, 0), expected_um, displacement_um)
        before_um = self._last_error_um
        self._last_error_um = float(np.mean(expected_um) - np.mean(displacement_um))
        if self._feedback is None or first < self._plan.feedback_start_sample:
            return 0.0
        if self._answers_from is None:
            self._answers_from = first
            self._initial_um = before_um if first else float(expected_um[0] - displacement_um[0])
        begin_s = time.perf_counter()
        voltage_v = self._feedback.step(
            expected_um - self._faded_um(first - self._answers_from, len(expected_um)),
            displacement_um)
        self._answer_times.add(time.perf_counter() - begin_s)
        return voltage_v

    def _faded_um(self, since: int, count: int) -> FloatArray:
        """Return the part of the initial error that is still hidden from the feedback, (count,)."""
        samples = self._fade_s / self._tick_s * count
        if since >= samples:
            return np.zeros(count)
        return self._initial_um * (1.0 - smooth_rise((since + np.arange(count)) / samples))

    @property
    def lateness(self) -> str:
        """Return a warning if answers took longer than a tick; empty otherwise."""
        times = self._answer_times
        if 100 * times.late <= (100 - USUAL_PERCENT) * times.count:
            return ""
        return (f"{times.late} of {times.count} answers of the feedback took longer to compute "
                f"than the tick of {1e6 * self._tick_s:.0f} us: at the wall clock they would be "
                f"late ({USUAL_PERCENT} % took {1e6 * times.percentile_s(USUAL_PERCENT):.0f} us "
                "or less)")

    @property
    def not_followed(self) -> str:
        """Return a warning if the error was about that of a stage at rest; empty otherwise."""
        if not self._counted:
            return ""
        mean_um = self._expected_sum / self._counted
        at_rest_um = math.sqrt(max(self._expected_squares / self._counted - mean_um**2, 0.0))
        error_um = math.sqrt(self._squares / self._counted)
        if at_rest_um < self.tolerance_um or error_um < SHARE_AT_REST * at_rest_um:
            return ""
        return (f"{NOT_FOLLOWED}: its rms error is {error_um:.3g} um, and that of a stage which "
                f"rests at the mean {at_rest_um:.3g} um; use composite, or a slower reference")

    @property
    def note(self) -> str:
        """Return the warnings of the run; empty without any."""
        return "; ".join(filter(None, (self.not_followed, self.lateness)))

    def _account(self, before: int, expected_um: FloatArray, displacement_um: FloatArray) -> None:
        """Add a block to the error statistics, except its samples before the counted part."""
        expected_um, displacement_um = expected_um[before:], displacement_um[before:]
        if not expected_um.size:
            return
        self._lowest_um = min(self._lowest_um, expected_um.min())
        self._highest_um = max(self._highest_um, expected_um.max())
        error_um = expected_um - displacement_um
        squares = float(error_um @ error_um)
        self._squares += squares
        self._counted += error_um.size
        self._expected_sum += float(expected_um.sum())
        self._expected_squares += float(expected_um @ expected_um)
        self.largest_error_um = float(np.fmax(self.largest_error_um, np.abs(error_um).max()))
        self._window.add(squares, error_um.size)
        self._target.add(error_um)

    @property
    def _travel_um(self) -> float:
        """Return the larger of the planned travel and that of the samples so far (um)."""
        return max(self._planned_travel_um, self._highest_um - self._lowest_um)

    def e_rms_percent(self, running: bool = False) -> float:
        """Return the error (2.32) of the counted part so far; with `running`, of its last samples.

        The error is in percent, and NaN before that part begins.
        """
        if running:
            return 100.0 * self._window.rms / self._travel_um
        if not self._counted:
            return math.nan
        return 100.0 * math.sqrt(self._squares / self._counted) / self._travel_um


class RunningSquares:
    """Root mean square of the last samples, updated block by block.

    At least `samples` of them are kept; there may be up to a block more.
    """

    def __init__(self, samples: int) -> None:
        self._wanted = samples
        self._blocks: deque[tuple[float, int]] = deque()
        self.samples = 0

    def add(self, squares: float, samples: int) -> None:
        """Add the sum of squares of a block."""
        self._blocks.append((squares, samples))
        self.samples += samples
        while self.samples - self._blocks[0][1] >= self._wanted:
            self.samples -= self._blocks.popleft()[1]

    @property
    def rms(self) -> float:
        """Return the root mean square; NaN before the first block."""
        # Copied at once, as one thread reads while another adds.
        blocks = tuple(self._blocks)
        if not blocks:
            return math.nan
        return math.sqrt(sum(squares for squares, _ in blocks) / sum(count for _, count in blocks))
