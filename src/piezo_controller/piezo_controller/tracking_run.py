# SPDX-License-Identifier: BSD-3-Clause
"""One run of the loop: answers every block, and keeps the account of the error."""

import time

import numpy as np


class TrackingRun:
    """Follow a plan block by block.

    Parameters
    ----------
    plan : FeedforwardPlan
        What the stage plays from the run's first sample on.
    run_samples : int
        Length of the periodic part; the error is that of this part.
    feedback : MultirateFeedback, optional
        Answers the blocks; None where only the feedforward acts.
    tick_s : float
        Period of the feedback (s).
    """

    def __init__(self, plan, run_samples, feedback=None, tick_s=1e-3):
        self._feedback = feedback
        self._tick_s = tick_s
        self._answer_times_s = []
        self._feedback_start_sample = plan.feedback_start_sample
        self._once_samples = len(plan.once_voltage_v)
        self.samples = 0
        self.total_samples = self._once_samples + run_samples
        self._expected_um = plan.expected_um(0, self.total_samples)
        self._displacement_um = np.full(self.total_samples, np.nan)
        self._travel_um = np.ptp(self._expected_um[self._once_samples:])

    @property
    def complete(self):
        """Whether every sample of the periodic part has been taken."""
        return self.samples >= self.total_samples

    @property
    def fraction(self):
        """Done of the whole, 0 to 1."""
        return min(1.0, self.samples / self.total_samples)

    def take(self, displacement_um):
        """Take the next block of samples.

        Parameters
        ----------
        displacement_um : ndarray, shape (n,)
            Measured.

        Returns
        -------
        feedback_v : float
            The answer to the block (V); zero where there is no feedback or not yet.
        """
        first = self.samples
        self.samples += len(displacement_um)
        expected_um = self._expected_um[first:self.samples]
        displacement_um = displacement_um[:len(expected_um)]
        self._displacement_um[first:self.samples] = displacement_um
        if self._feedback is None or not self._feedback_start_sample <= first < self.total_samples:
            return 0.0
        begin_s = time.perf_counter()
        voltage_v = self._feedback.step(expected_um, displacement_um)
        self._answer_times_s.append(time.perf_counter() - begin_s)
        return voltage_v

    @property
    def lateness(self):
        """What to tell of answers that no stage at the wall clock could have waited for."""
        if not self._answer_times_s:
            return ""
        usual_s = float(np.percentile(self._answer_times_s, 99.0))
        if usual_s <= self._tick_s:
            return ""
        late = int(np.count_nonzero(np.array(self._answer_times_s) > self._tick_s))
        return (f"{late} of {len(self._answer_times_s)} answers of the feedback took longer to "
                f"compute than the tick of {1e6 * self._tick_s:.0f} us: at the wall clock they "
                f"would be late (99 % took {1e6 * usual_s:.0f} us or less)")

    def e_rms_percent(self, last_samples=None):
        """Error of the periodic part so far, (2.32); of its last samples if so asked.

        Returns
        -------
        float
            NaN before the periodic part begins.
        """
        end = min(self.samples, self.total_samples)
        begin = self._once_samples
        if last_samples is not None:
            begin = max(begin, end - last_samples)
        if begin >= end:
            return float("nan")
        error_um = self._expected_um[begin:end] - self._displacement_um[begin:end]
        return float(100.0 * np.sqrt(np.mean(error_um**2)) / self._travel_um)

    @property
    def largest_error_um(self):
        """Largest error of the periodic part (um)."""
        error_um = (self._expected_um - self._displacement_um)[self._once_samples:]
        return float(np.nanmax(np.abs(error_um)))
