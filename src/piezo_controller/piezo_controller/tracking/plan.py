# SPDX-License-Identifier: BSD-3-Clause
"""Interface of the plan of a tracking run, which is periodic, streamed or learned."""

from collections.abc import Callable
from typing import Protocol

from piezo_common.arrays import FloatArray


class TrackingPlan(Protocol):
    """Voltages that the stage plays and displacements to expect, from the run's first sample on.

    `FeedforwardPlan`, `StreamPlan`, `LivePlan` and `LearningFeedforward` fulfil it.

    Attributes
    ----------
    once_voltage_v : ndarray, shape (n,)
        Voltages that are played first (V).
    period_voltage_v : ndarray, shape (m,)
        Voltages that are repeated after those (V); empty if the plan is streamed.
    streamed : bool
        Whether further voltages come from `continuation` while the stage plays.
    open_ended : bool
        Whether the length of the run becomes known only while it is played.
    begin_sample : int
        Sample from which on the error counts; for an open-ended plan the latest possible, until it
        is known.
    feedback_start_sample : int
        Sample from which on feedback may act; before it the stage's past differs from the model's.
    iteration : int
        Present iteration of the learning; 0 without learning.
    uncompensated : tuple of str
        Effects of the model that remain in the error.
    note : str
        Remark to report at the end of the run; may be empty.
    degraded : str
        Why the run does not count, although it was played to its end; empty if it does.
    """

    # Properties, because a run only reads them.
    @property
    def once_voltage_v(self) -> FloatArray:
        """Return the voltages that are played first (V), shape (n,)."""

    @property
    def period_voltage_v(self) -> FloatArray:
        """Return the voltages that are repeated from then on (V), shape (m,)."""

    @property
    def streamed(self) -> bool:
        """Return whether further voltages come from `continuation`."""

    @property
    def open_ended(self) -> bool:
        """Return whether the length is known only while the run is played."""

    @property
    def begin_sample(self) -> int:
        """Return the sample from which on the error counts."""

    @property
    def feedback_start_sample(self) -> int:
        """Return the sample from which on feedback may act."""

    @property
    def iteration(self) -> int:
        """Return the present iteration of the learning."""

    @property
    def uncompensated(self) -> tuple[str, ...]:
        """Return the names of the effects that remain in the error."""

    @property
    def note(self) -> str:
        """Return a remark to report at the end of the run."""

    @property
    def degraded(self) -> str:
        """Return why the run does not count; empty if it does."""

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
