# SPDX-License-Identifier: BSD-3-Clause
"""What a tracking run asks of a plan, whether it repeats a period, is streamed, or learns."""

from collections.abc import Callable
from typing import Protocol

from piezo_common.arrays import FloatArray


class TrackingPlan(Protocol):
    """Voltages for the stage to play and displacements to expect, from the run's first sample on.

    `FeedforwardPlan`, `StreamPlan`, `LivePlan` and `LearningFeedforward` fulfil it.

    Attributes
    ----------
    once_voltage_v : ndarray, shape (n,)
        Played first.
    period_voltage_v : ndarray, shape (m,)
        Repeated from then on; empty if the plan is streamed.
    streamed : bool
        Whether further voltages come from `continuation` while the stage plays.
    open_ended : bool
        Whether how long the run takes is known only while it is played.
    begin_sample : int
        Where the part begins whose error counts; of an open-ended plan the latest possible, until
        it is known.
    feedback_start_sample : int
        Where feedback may begin: before it the stage's past is not the model's.
    iteration : int
        The present iteration of the learning; 0 where none is made.
    uncompensated : tuple of str
        Effects of the model that stay in the error.
    note : str
        What to tell of the run at its end; may be empty.
    degraded : str
        Why the run does not count, though it was played to its end; empty if it does.
    """

    # As properties, because a run only reads them.
    @property
    def once_voltage_v(self) -> FloatArray:
        """Return the voltages that are played first (V), shape (n,)."""

    @property
    def period_voltage_v(self) -> FloatArray:
        """Return the voltages that are repeated from then on (V), shape (m,)."""

    @property
    def streamed(self) -> bool:
        """Tell whether further voltages come from `continuation`."""

    @property
    def open_ended(self) -> bool:
        """Tell whether the length is known only while the run is played."""

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
        """Return the names of effects that stay in the error."""

    @property
    def note(self) -> str:
        """Return what to tell of the run at its end."""

    @property
    def degraded(self) -> str:
        """Return why the run does not count; empty if it does."""

    def expected_um(self, first_sample: int, count: int) -> FloatArray:
        """Return the displacements to expect of some samples.

        Returns
        -------
        ndarray, shape (count,)
            In um.
        """

    def travel_um(self, samples: int) -> float:
        """Return the peak-to-peak displacement of the first samples of the reference (um)."""

    def continuation(self) -> Callable[[], FloatArray | None] | None:
        """Return what gives the voltages behind `once_voltage_v`; None unless `streamed`.

        Each call of it gives the next voltages (V), shape (k,): none at the end, and None while
        they depend on what is not measured yet.
        """

    def take(self, displacement_um: FloatArray) -> None:
        """Take the samples that were measured next, from the run's first on.

        Parameters
        ----------
        displacement_um : ndarray, shape (n,)
        """
