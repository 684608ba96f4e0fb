# SPDX-License-Identifier: BSD-3-Clause
"""The inverse hysteresis that a feedback passes while it runs."""

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_models.feedback_law.feedback_law import FeedbackLawError, InverseHysteresis
from piezo_models.feedback_law.law_kernels import through_inverse
from piezo_models.hysteresis.preisach_kernels import simulate

PLANNED, PLAYED = 0, 1
FREE_ENTRIES = 256


class RunningInverse:
    """Memories of the hysteresis for the planned voltages and for the played ones.

    The run begins at the rest voltage (V), reached from negative saturation.
    """

    def __init__(self, inverse: InverseHysteresis, rest_voltage_v: float) -> None:
        self._gain_um_per_v, self._held = inverse.gain_um_per_v, inverse.held
        self._hysteresis = inverse.hysteresis
        self._kernel = inverse.hysteresis.kernel_arguments()
        self._range_um = inverse.hysteresis.output_range_um
        self._stacks, self._tops = np.empty((6, FREE_ENTRIES)), np.zeros(2, dtype=np.int64)
        for which in PLANNED, PLAYED:
            self._reach(which, [rest_voltage_v])

    def past_v(self, which: int) -> FloatArray:
        """Return the stored extremes of the planned or the played voltage, shape (k,)."""
        return self._stacks[2 * which, 1:self._tops[which] + 1].copy()

    def pass_on(self, wanted_v: float, planned_v: FloatArray, lowest_v: float,
                highest_v: float, feedback_v: FloatArray) -> tuple[float, float]:
        """Fill `feedback_v` with the voltages to add to planned voltages.

        Returned are the mean of `feedback_v`, and of what its bounds cut off (V).
        """
        self._make_room(len(planned_v))
        grid, table, rounding_um = self._kernel
        return through_inverse(
            self._gain_um_per_v * wanted_v, planned_v, rounding_um, self._range_um,
            (lowest_v, highest_v), self._held, self._stacks, self._tops, grid, table, feedback_v)

    def follow(self, planned_v: FloatArray) -> None:
        """Update both memories with planned voltages that are played unchanged."""
        self._make_room(len(planned_v))
        grid, table, _ = self._kernel
        for which in PLANNED, PLAYED:
            self._tops[which] = simulate(
                planned_v, self._stacks[2 * which], self._stacks[2 * which + 1],
                self._tops[which], grid, table)[3]

    def take_over(self, other: "RunningInverse | None") -> None:
        """Continue with the past of another inverse.

        Raises `FeedbackLawError` if there is none, or it has another voltage range.
        """
        if other is None or self._kernel[0][:2] != other._kernel[0][:2]:
            raise FeedbackLawError("the law that acts does not give the past of this law's "
                                   "hysteresis: load it between two runs")
        # The extremes of the voltage determine the state of every Preisach hysteresis.
        for which in PLANNED, PLAYED:
            self._reach(which, other.past_v(which))

    def _reach(self, which: int, voltage_v: FloatArray | list[float]) -> None:
        memory = self._hysteresis.memory()
        self._hysteresis.simulate(np.asarray(voltage_v), memory)
        self._make_room(memory.top)
        used, self._tops[which] = memory.top + 1, memory.top
        self._stacks[2 * which, :used] = memory.extremes_v[:used]
        self._stacks[2 * which + 1, :used] = memory.outputs_um[:used]

    def _make_room(self, samples: int) -> None:
        """Extend the stacks, if necessary, so that the kernels have room for the samples."""
        if max(self._tops) + 2 * samples + 2 > self._stacks.shape[1]:
            longer = np.empty((6, 2 * (self._stacks.shape[1] + samples)))
            longer[:, :self._stacks.shape[1]] = self._stacks
            self._stacks = longer
