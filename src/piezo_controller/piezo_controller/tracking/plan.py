# SPDX-License-Identifier: BSD-3-Clause
"""Interface of the plan of a tracking run, which is periodic, streamed or learned."""

from collections.abc import Callable
from typing import Protocol

from piezo_common.arrays import FloatArray


class TrackingPlan(Protocol):
    """Voltages that the stage plays and displacements to expect, from the run's first sample on.

    `FeedforwardPlan`, `StreamPlan`, `LivePlan` and `LearningFeedforward` fulfil it.
    """

    # Properties, because a run only reads them.
    @property
    def once_voltage_v(self) -> FloatArray:
        """Return the voltages that are played first (V), shape (n,)."""

    @property
    def period_voltage_v(self) -> FloatArray:
        """Return the voltages that are repeated from then on (V), shape (m,); empty if streamed."""

    @property
    def streamed(self) -> bool:
        """Return whether further voltages come from `continuation` while the stage plays."""

    @property
    def open_ended(self) -> bool:
        """Return whether the length is known only while the run is played."""

    @property
    def begin_sample(self) -> int:
        """Return the sample from which on the error counts.

        For an open-ended plan it is the latest possible, until it is known.
        """

    @property
    def feedback_start_sample(self) -> int:
        """Return the sample from which on feedback may act.

        Before it the stage's past differs from the model's.
        """

    @property
    def iteration(self) -> int:
        """Return the present iteration of the learning; 0 without learning."""

    @property
    def uncompensated(self) -> tuple[str, ...]:
        """Return the names of the effects of the model that remain in the error."""

    @property
    def note(self) -> str:
        """Return a remark to report at the end of the run; may be empty."""

    @property
    def degraded(self) -> str:
        """Return why the run does not count, although it was played to its end; may be empty."""

    def expected_um(self, first_sample: int, count: int) -> FloatArray:
        """Return the displacements to expect (um), shape (count,)."""

    def travel_um(self, samples: int) -> float:
        """Return the peak-to-peak displacement of the first samples of the reference (um)."""

    def continuation(self) -> Callable[[], FloatArray | None] | None:
        """Return a function that gives the voltages after `once_voltage_v`; None unless `streamed`.

        Each call returns the next voltages (V), shape (k,): empty at the end, and None while they
        depend on samples that are not measured yet.
        """

    def take(self, displacement_um: FloatArray) -> None:
        """Take the displacements that were measured next, from the run's first sample on.

        Parameters
        ----------
        displacement_um : ndarray, shape (n,)
        """
