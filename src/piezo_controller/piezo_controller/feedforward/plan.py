# SPDX-License-Identifier: BSD-3-Clause
"""The common base of the plans of a tracking run, periodic, streamed or learned."""

from abc import ABC, abstractmethod
from collections.abc import Callable

from piezo_common.arrays import FloatArray


class TrackingPlan(ABC):
    """Voltages that the stage plays and displacements to expect, from the run's first sample on."""

    once_voltage_v: FloatArray
    """Voltages that are played first (V), (n,)."""
    period_voltage_v: FloatArray
    """Voltages that are repeated from then on (V), (m,); empty if streamed."""
    begin_sample: int
    """Sample from which on the error counts; the latest possible until an open-ended plan knows."""
    feedback_start_sample: int
    """Sample from which on feedback may act; before, the stage's past differs from the model's."""
    uncompensated: tuple[str, ...]
    """Effects of the model that are not compensated, and remain in the error."""

    streamed: bool = False
    """Whether further voltages come from `continuation` while the stage plays."""
    open_ended: bool = False
    """Whether the length is known only while the run is played."""
    iteration: int = 0
    """Present iteration of the learning; 0 without learning."""

    @property
    def note(self) -> str:
        """Return a remark to report at the end of the run; may be empty."""
        return ""

    @property
    def degraded(self) -> str:
        """Return why the run does not count, although it was played to its end; may be empty."""
        return ""

    @abstractmethod
    def expected_um(self, first_sample: int, count: int) -> FloatArray:
        """Return the displacements to expect of `count` samples from `first_sample` on (um)."""

    @abstractmethod
    def travel_um(self, samples: int) -> float:
        """Return the peak-to-peak displacement of the first samples of the reference (um)."""

    def continuation(self) -> Callable[[], FloatArray | None] | None:
        """Return a function that gives the voltages after `once_voltage_v`; None unless `streamed`.

        Each call returns the next voltages (V), shape (k,): empty at the end, and None while they
        depend on samples that are not measured yet.
        """
        return None

    def take(self, displacement_um: FloatArray) -> None:  # noqa: B027
        """Take the displacements (um) that were measured next, from the run's first sample on."""
