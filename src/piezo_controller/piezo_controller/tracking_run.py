# SPDX-License-Identifier: BSD-3-Clause
"""One run of the loop: answers every block, and keeps the account of the error."""

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
    """

    def __init__(self, plan, run_samples, feedback=None):
        self._plan = plan
        self._feedback = feedback
        self._once_samples = len(plan.once_voltage_v)
        self._reference_um = plan.expected_um(self._once_samples, run_samples)
        self._displacement_um = np.full(run_samples, np.nan)
        self.samples = 0
        self.total_samples = self._once_samples + run_samples

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
        first, count = self.samples, len(displacement_um)
        self.samples += count
        start = max(first, self._once_samples)
        within = displacement_um[start - first:]
        at = start - self._once_samples
        room = max(0, len(self._displacement_um) - at)
        self._displacement_um[at:at + len(within)] = within[:room]
        if self._feedback is None or first < self._plan.feedback_start_sample:
            return 0.0
        return self._feedback.step(self._plan.expected_um(first, count), displacement_um)

    def e_rms_percent(self, last_samples=None):
        """Error of the periodic part so far, (2.32); of its last samples if so asked.

        Returns
        -------
        float
            NaN before the periodic part begins.
        """
        end = min(max(self.samples - self._once_samples, 0), len(self._reference_um))
        begin = 0 if last_samples is None else max(0, end - last_samples)
        if begin == end:
            return float("nan")
        error_um = self._reference_um[begin:end] - self._displacement_um[begin:end]
        return float(100.0 * np.sqrt(np.mean(error_um**2)) / np.ptp(self._reference_um))

    @property
    def largest_error_um(self):
        """Largest error of the periodic part (um)."""
        return float(np.nanmax(np.abs(self._reference_um - self._displacement_um)))
