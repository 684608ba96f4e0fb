# SPDX-License-Identifier: BSD-3-Clause
"""The inverse hysteresis that a feedback passes while it runs."""

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_models.feedback_law.feedback_law import FeedbackLawError, InverseHysteresis
from piezo_models.feedback_law.law_kernels import through_inverse
from piezo_models.hysteresis.preisach import PreisachMemory
from piezo_models.hysteresis.preisach_kernels import simulate


class RunningInverse:
    """What the hysteresis remembers of the planned voltages, and of the played ones.

    Parameters
    ----------
    inverse : InverseHysteresis
    rest_voltage_v : float
        Where the run begins, reached from negative saturation (V).
    """

    def __init__(self, inverse: InverseHysteresis, rest_voltage_v: float) -> None:
        self._gain_um_per_v, self._held = inverse.gain_um_per_v, inverse.held
        self._hysteresis = inverse.hysteresis
        self._kernel = inverse.hysteresis.kernel_arguments()
        self._range_um = inverse.hysteresis.output_range_um
        self._planned, self._played = (self._reached([rest_voltage_v]) for _ in range(2))

    def pass_on(self, wanted_v: float, planned_v: FloatArray, lowest_v: float,
                highest_v: float, feedback_v: FloatArray) -> float:
        """Fill `feedback_v` with what is added to planned voltages; return its mean (V)."""
        grid, table, rounding_um = self._kernel
        planned, played = through_inverse(
            self._gain_um_per_v * wanted_v, planned_v, rounding_um, *self._range_um, lowest_v,
            highest_v, self._held, self._planned, self._played, grid, table, feedback_v)
        self._planned, self._played = planned[1:], played[1:]
        return float(feedback_v.mean())

    def follow(self, planned_v: FloatArray) -> None:
        """Remember planned voltages that are played as they are."""
        grid, table, _ = self._kernel
        self._planned, self._played = (
            simulate(planned_v, *past, grid, table)[1:] for past in (self._planned, self._played))

    def take_over(self, other: "RunningInverse | None") -> None:
        """Go on with the past of another inverse.

        Raises
        ------
        FeedbackLawError
            There is none, or it is of another voltage range.
        """
        if other is None or self._kernel[0][:2] != other._kernel[0][:2]:
            raise FeedbackLawError("the law that acts does not tell the past of this law's "
                                   "hysteresis: load it between two runs")
        # The extremes of the voltage are the past of every Preisach hysteresis.
        self._planned, self._played = (
            self._reached(extremes_v[1:top + 1]) for extremes_v, _, top in (
                other._planned, other._played))

    def _reached(self, voltage_v: FloatArray | list[float],
                 ) -> tuple[FloatArray, FloatArray, int]:
        memory: PreisachMemory = self._hysteresis.memory()
        self._hysteresis.simulate(np.asarray(voltage_v), memory)
        return memory.extremes_v, memory.outputs_um, memory.top
