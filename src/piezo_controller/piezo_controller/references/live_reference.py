# SPDX-License-Identifier: BSD-3-Clause
"""A queue for a reference that is published while the stage follows it."""

import threading
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from piezo_common.arrays import FloatArray
from piezo_controller.references.kind import InvalidReference

TOPIC = "topic"
"""Kind of a reference that is published on a topic."""

LONGEST_GAP_S = 0.1
"""Longest gap of omitted values that is bridged by a straight line (s)."""

LONGEST_WAIT_S = 2.0
"""Values that have waited longer than this are dropped (s)."""


class LiveReference:
    """Queue the published pieces of a reference, and return them sample by sample.

    Safe to use from several threads. The publisher counts as silent after `patience_s` without a
    message; an offset is added to every value, and raises `InvalidReference` if it is not finite.

    From the first message on, `preview_samples` is how far the values lie ahead of the publisher's
    present. `longest_samples` is the number of samples in the longest message, and `latest_um` the
    last value (um), NaN before the first. `bridged_samples` counts the omitted samples that were
    bridged.
    """

    def __init__(self, sample_period_s: float, patience_s: float = 0.0, offset_um: float = 0.0,
                 clock: Callable[[], float] = time.monotonic) -> None:
        if not np.isfinite(offset_um):
            raise InvalidReference("centre_um of the reference is not a finite number: "
                                   "give what is added to each value, or 0")
        self._sample_period_s, self._offset_um = sample_period_s, offset_um
        self.patience_s, self._clock = patience_s, clock
        self._most_samples = round(LONGEST_WAIT_S / sample_period_s)
        self._lock = threading.Lock()
        self._waiting = np.empty(0)
        self._next_number = 0
        self._heard_s = clock()
        self.preview_samples = self.longest_samples = self.bridged_samples = 0
        self.latest_um = np.nan

    @property
    def begun(self) -> bool:
        """Return whether a value has been received."""
        return not np.isnan(self.latest_um)

    @property
    def silent(self) -> bool:
        """Return whether nothing has been published for `patience_s`."""
        return self._clock() - self._heard_s >= self.patience_s

    @property
    def waiting_samples(self) -> int:
        """Return the number of samples in the queue."""
        return self._waiting.size

    def take(self, first_sample: int, sample_period_s: float, preview_samples: int,
             displacement_um: ArrayLike) -> None:
        """Queue a message, see ``piezo_interfaces/ReferenceSamples``.

        Raises `InvalidReference` if the message is invalid; it then has no effect.
        """
        values_um = np.asarray(displacement_um, dtype=float) + self._offset_um
        repeat = self._clock_samples(sample_period_s)
        if not values_um.size or not np.isfinite(values_um).all():
            raise InvalidReference("a message of the reference holds no or no finite "
                                   "displacements: publish numbers")
        with self._lock:
            if self.begun and preview_samples != self.preview_samples:
                raise InvalidReference(
                    f"preview_samples of the reference is now {preview_samples}, but was "
                    f"{self.preview_samples}: keep it, or cancel the run")
            self.preview_samples = preview_samples
            self._heard_s = self._clock()
            left_out = first_sample - self._next_number
            if not self.begun or first_sample == 0 or \
                    left_out * repeat * self._sample_period_s > LONGEST_GAP_S:
                left_out = 0
            values_um = values_um[max(-left_out, 0):]
            if values_um.size:
                self._append(values_um, max(left_out, 0), repeat)
                self._next_number = first_sample + len(np.atleast_1d(displacement_um))

    def _append(self, values_um: FloatArray, left_out: int, repeat: int) -> None:
        """Queue values, joined to one another and to the previous value by straight lines."""
        before_um = self.latest_um if self.begun else values_um[0]
        at = np.r_[0, left_out + 1 + np.arange(values_um.size)] * repeat
        samples_um = np.interp(np.arange(1, at[-1] + 1), at, np.r_[before_um, values_um])
        self._waiting = np.r_[self._waiting, samples_um][-self._most_samples:]
        self.longest_samples = max(self.longest_samples, values_um.size * repeat)
        self.bridged_samples += left_out * repeat
        self.latest_um = float(values_um[-1])

    def _clock_samples(self, sample_period_s: float) -> int:
        """Return the number of clock samples from one value to the next."""
        ratio = sample_period_s / self._sample_period_s if sample_period_s else 1.0
        if not 0.5 <= ratio <= self._most_samples or abs(ratio - round(ratio)) > 1e-6 * ratio:
            raise InvalidReference(
                f"sample_period_s of the reference is {sample_period_s:g}: give a whole multiple "
                f"of the sample clock's {self._sample_period_s:g} s, or 0")
        return round(ratio)

    def give(self, most_samples: int) -> FloatArray:
        """Remove the next samples from the queue and return them (um), shape (n,); n may be 0."""
        with self._lock:
            given, self._waiting = np.split(self._waiting, [most_samples])
            return given

    def keep_newest(self, samples: int) -> None:
        """Drop all but the newest samples of the queue."""
        with self._lock:
            self._waiting = self._waiting[max(self._waiting.size - samples, 0):]
