# SPDX-License-Identifier: BSD-3-Clause
"""Guards that stop the stage: each examines what happens and reports a fault.

A guard of the sensor examines every stretch of samples; the guard of the feedback examines
every answer before it acts. The result is empty, or the cause of a stop.
"""

import math
import threading
import time
from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np

from piezo_stage_driver.engine.program import StageRefusal
from piezo_stage_driver.safety.sample_kernels import extremes, fourth_difference, tick_means

# In samples of the clock. Single outliers are glitches, not the loss of the sensor.
RANGE_PATIENCE_SAMPLES = 20
NOISE_PATIENCE_SAMPLES = 400
RESPONSE_PATIENCE_SAMPLES = 800


class StopLatch:
    """Store the cause of a stop until it is reset; any thread may stop the stage.

    Parameters
    ----------
    clock : callable
        Returns the time (s).

    Attributes
    ----------
    cause : str
        Cause of the first stop; empty if there was none.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self.cause = ""
        self._clock, self._stopped_s = clock, -math.inf
        self._lock = threading.Lock()

    def stop(self, cause: str) -> None:
        """Store the cause, unless there is one already."""
        with self._lock:
            self.cause, self._stopped_s = self.cause or cause, self._clock()

    def reset(self, asked_s: float = math.inf) -> None:
        """Clear the cause; raise `StageRefusal` if the request (s) is older than the last stop."""
        with self._lock:
            if self.cause and asked_s < self._stopped_s:
                raise StageRefusal("the stage was stopped after this was asked for "
                                   f"({self.cause}): look why, then ask again")
            self.cause = ""


class Stretch(NamedTuple):
    """Voltages and displacements since the last examination."""

    voltage_v: np.ndarray
    """Mean voltage over each tick, (ticks,)."""
    displacement_um: np.ndarray
    """Shape (n,)."""
    lowest_um: float
    highest_um: float
    """Extremes of the displacement."""

    @classmethod
    def of(cls, voltage_v: np.ndarray, displacement_um: np.ndarray,
           samples_per_tick: int) -> "Stretch":
        """Return a stretch of samples, shape (n,), of whole ticks."""
        return cls(tick_means(voltage_v, samples_per_tick), displacement_um,
                   *extremes(displacement_um))


class SensorGuard(Protocol):
    """Interface of a guard that examines every stretch of samples."""

    def begin(self) -> None:
        """Reset the guard."""

    def examine(self, stretch: Stretch) -> str:
        """Return what is wrong with a `Stretch`; empty if nothing is."""


class SensorRange:
    """Detect a reading that is not a number, or outside the range of the sensor.

    The range is that which the stage can reach, with a margin.
    """

    def __init__(self, minimum_um: float, maximum_um: float):
        self._minimum_um, self._maximum_um = minimum_um, maximum_um
        self.begin()

    def begin(self) -> None:
        """Reset the guard."""
        self._outside_samples = 0

    def examine(self, stretch: Stretch) -> str:
        """Return what is wrong with a `Stretch`; empty if nothing is."""
        if not (math.isfinite(stretch.lowest_um) and math.isfinite(stretch.highest_um)):
            return "the sensor's reading is not a number"
        if self._minimum_um <= stretch.lowest_um and stretch.highest_um <= self._maximum_um:
            self._outside_samples = 0
            return ""
        readings_um = stretch.displacement_um
        outside = (readings_um < self._minimum_um) | (readings_um > self._maximum_um)
        self._outside_samples += int(outside.sum())
        if self._outside_samples < RANGE_PATIENCE_SAMPLES:
            return ""
        return (f"the sensor reads {readings_um[outside][-1]:g} um, outside "
                f"[{self._minimum_um:g}, {self._maximum_um:g}] um")


class SensorResponse:
    """Detect a reading that does not change when the voltage does.

    Changes are compared from tick to tick, as a stage need not follow faster ones. The change of
    the voltage that must move the stage is larger than its backlash, that of the reading which
    counts as a response larger than its noise.
    """

    def __init__(self, voltage_v: float = 20.0, displacement_um: float = 0.4):
        self._voltage_v, self._displacement_um = voltage_v, displacement_um
        self.begin()

    def begin(self) -> None:
        """Reset the guard."""
        self._waited_samples = 0
        self._lowest_v = self._lowest_um = math.inf
        self._highest_v = self._highest_um = -math.inf

    def examine(self, stretch: Stretch) -> str:
        """Return what is wrong with a `Stretch`; empty if nothing is."""
        lowest_v, highest_v = extremes(stretch.voltage_v)
        self._lowest_v = min(self._lowest_v, lowest_v)
        self._highest_v = max(self._highest_v, highest_v)
        self._lowest_um = min(self._lowest_um, stretch.lowest_um)
        self._highest_um = max(self._highest_um, stretch.highest_um)
        if self._highest_um - self._lowest_um > self._displacement_um:
            self.begin()
            return ""
        change_v = self._highest_v - self._lowest_v
        if change_v > self._voltage_v:
            self._waited_samples += len(stretch.displacement_um)
        if self._waited_samples < RESPONSE_PATIENCE_SAMPLES:
            return ""
        return f"the sensor is stuck: it did not move while the voltage changed by {change_v:.3g} V"


class SensorNoise:
    """Detect a reading with far more noise than normal.

    The noise is estimated from fourth differences, in which the motion of the stage is negligible.
    """

    WEIGHTS = np.array([1.0, -4.0, 6.0, -4.0, 1.0])

    def __init__(self, largest_rms_um: float):
        self._largest_rms_um = largest_rms_um
        # Ratio of the rms of normal noise to the mean of its absolute fourth difference.
        self._scale = math.sqrt(np.pi / 2.0) / float(np.linalg.norm(self.WEIGHTS))
        self.begin()

    def begin(self) -> None:
        """Reset the guard."""
        self._noisy_samples = 0
        self._tail_um = np.empty(0)

    def examine(self, stretch: Stretch) -> str:
        """Return what is wrong with a `Stretch`; empty if nothing is."""
        readings_um = stretch.displacement_um
        if len(readings_um) < 2 * len(self.WEIGHTS):
            readings_um = np.r_[self._tail_um, readings_um]
            self._tail_um = readings_um[1 - len(self.WEIGHTS):]
        if len(readings_um) < len(self.WEIGHTS):
            return ""
        rms_um = self._scale * fourth_difference(readings_um)
        noisy = rms_um > self._largest_rms_um
        self._noisy_samples = self._noisy_samples + len(stretch.displacement_um) if noisy else 0
        if self._noisy_samples < NOISE_PATIENCE_SAMPLES:
            return ""
        return (f"the sensor's noise is {rms_um:.2g} um RMS, above {self._largest_rms_um:g} um: "
                "look at its cable and supply")


class FeedbackOscillation:
    """Detect feedback that oscillates with a growing amplitude.

    An unstable loop oscillates with a half period of a few ticks. Each swing is larger than all
    before, either by a little, or several times as large twice in a row. Swings that are as slow as
    most references, keep their size, or are large from the beginning are accepted. A reference of
    many fast tones that only feedback follows may be mistaken for growth. A growing oscillation
    stops the stage once its swing exceeds the limit, from peak to peak.
    """

    LONGEST_HALF_PERIOD_TICKS = 8
    # Growth that stops the stage, and ratio of two swings above which the growth begins anew.
    GROWTH, LEAP = 6.0, 20.0
    # Number of growing swings before the one that is stopped.
    GROWN_SWINGS = 2
    # Part of the largest swing; a smaller one in between ends the growth.
    LULL = 0.5
    # Ratio of two swings, twice in a row. A beginning reference has any ratio once, then 2.
    STEEP_GROWTH = 4.0
    # Part of a swing; a smaller change back is noise, not a turn.
    TURN = 0.1

    _begun_v: float
    _largest_v: float
    _grown_swings: int

    def __init__(self, limit_v: float):
        self._limit_v = limit_v
        self.begin()

    def begin(self) -> None:
        """Reset the guard."""
        self._turn_v = self._extreme_v = self._last_swing_v = 0.0
        self._ticks = 0
        self._steep = False
        self._rises = True
        self._restart(0.0)

    def examine(self, voltage_v: float) -> str:
        """Return what is wrong with the next feedback; empty if nothing is."""
        self._ticks += 1
        change_v = voltage_v - self._extreme_v
        if change_v > 0.0 if self._rises else change_v < 0.0:
            self._extreme_v = voltage_v
        elif abs(change_v) > self.TURN * abs(self._extreme_v - self._turn_v):
            self._turn(voltage_v)
        swing_v = abs(voltage_v - self._turn_v)
        if not self._fast or swing_v <= self._limit_v:
            return ""
        if not (self._outgrows_all(swing_v) or self._steep and self._is_steep(swing_v)):
            return ""
        return f"the feedback oscillates with growing amplitude, {swing_v:.2g} V from peak to peak"

    @property
    def _fast(self) -> bool:
        return self._ticks <= self.LONGEST_HALF_PERIOD_TICKS

    def _outgrows_all(self, swing_v: float) -> bool:
        """Return whether a swing continues a growth over several swings."""
        return (self._grown_swings >= self.GROWN_SWINGS and swing_v > self._largest_v
                and self.GROWTH * self._begun_v <= swing_v <= self.LEAP * self._largest_v)

    def _is_steep(self, swing_v: float) -> bool:
        """Return whether a swing is several times as large as the one before."""
        return 0.0 < self.STEEP_GROWTH * self._last_swing_v <= swing_v

    def _turn(self, voltage_v: float) -> None:
        """Evaluate the swing that has ended with the last extreme, and begin another."""
        swing_v = abs(self._extreme_v - self._turn_v)
        self._steep = self._is_steep(swing_v)
        self._last_swing_v = swing_v
        if not self._fast or swing_v < self.LULL * self._largest_v:
            self._restart(max(swing_v, self._largest_v))
        elif swing_v > self.LEAP * self._largest_v:
            self._restart(swing_v)
        elif swing_v > self._largest_v:
            self._largest_v = swing_v
            self._grown_swings += 1
        self._turn_v, self._extreme_v, self._ticks = self._extreme_v, voltage_v, 0
        self._rises = not self._rises

    def _restart(self, swing_v: float) -> None:
        """Restart the search for growth."""
        self._begun_v = self._largest_v = swing_v
        self._grown_swings = 0
