# SPDX-License-Identifier: BSD-3-Clause
"""The results of a probe, and how they are computed from the measured responses."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import lsq_linear

from piezo_common.arrays import FloatArray
from piezo_identification.conditioning.sensor_noise import spread_about_line
from piezo_identification.experiments.probing.step_response import StepResponse, step_response

SENSOR_MARGIN = 0.05
"""Fraction of the sensor's range that stays unused at both ends."""

LEAST_CREEP = 1e-3
"""Smallest change in an octave of time that counts as creep, as a fraction of the step."""

ENDED = 0.4
"""The creep has ended in an octave of time with less than this fraction of the largest creep."""


@dataclass(frozen=True)
class Rest:
    """A stage at rest."""

    level_um: float
    """Mean displacement."""
    noise_rms_um: float
    """Noise of a sample without linear drift; at least the rounding noise of the sensor."""
    resolution_um: float = 0.0
    """Smallest observed change of the reading; 0 if it never changed."""

    def of_mean_um(self, count: int) -> float:
        """Return the noise of the mean of `count` samples taken at the same motion.

        If the noise is smaller than half the resolution, each reading is rounded the same way.
        """
        white_um = self.noise_rms_um / np.sqrt(count)
        rounded_um = self.resolution_um / np.sqrt(12.0)
        return max(white_um, rounded_um) if self.noise_rms_um < 0.5 * self.resolution_um else (
            white_um)

    def seen_moving(self, displacement_um: FloatArray) -> "Rest":
        """Return a copy with the resolution determined from a motion.

        At rest, a converter whose steps are larger than the noise gives constant readings.
        """
        finest_um = min(self.resolution_um or np.inf, _smallest_change_um(displacement_um))
        if not np.isfinite(finest_um):
            return self
        return replace(self, resolution_um=finest_um, noise_rms_um=max(
            self.noise_rms_um, finest_um / np.sqrt(12.0)))


@dataclass(frozen=True)
class Pulse:
    """The response to one pulse of the voltage, from rest and back."""

    rise_um: float
    fall_um: float
    """Change of the displacement caused by the rise and by the fall of the voltage, both with the
    sign of the rise."""
    highest_um: float
    lowest_um: float
    """Largest excursions above and below rest less the noise, not negative."""
    unsettled: float
    """Change in the last quarter of the dwell as a fraction of the rise."""


@dataclass(frozen=True)
class Creep:
    """How the displacement creeps after a step."""

    share_per_decade: float
    """Creep per decade of time as a fraction of the step, averaged over the hold."""
    time_s: float
    """End of the last octave of time with notable creep; 0 without creep."""
    ended: bool
    """Whether the creep faded before the end of the hold."""


@dataclass(frozen=True)
class Findings:
    """The results of a probe."""

    rest: Rest

    step_v: float
    """Step at which gain, response and creep were measured, signed."""
    gain_um_per_v: float
    """Gain of the first rise to this step, signed."""
    signal_to_noise: float
    """Height of the repeated step over the noise of one sample."""
    response: StepResponse
    creep: Creep


def measure_rest(displacement_um: FloatArray) -> Rest:
    """Measure level and noise of a stage that rests."""
    level_um = float(displacement_um.mean())
    least_um = 1e-6 * max(1.0, abs(level_um))
    noise_um = max(spread_about_line(displacement_um), least_um)
    # Without noise, a converter does not resolve changes below one of its steps.
    return Rest(level_um, noise_um).seen_moving(displacement_um)


def _smallest_change_um(displacement_um: FloatArray) -> float:
    """Return the smallest change from sample to sample; infinity if there is none."""
    changes_um = np.abs(np.diff(displacement_um))
    rounding_um = 1e-9 * float(np.abs(displacement_um).max(initial=0.0))
    return float(changes_um[changes_um > rounding_um].min(initial=np.inf))


def measure_pulse(displacement_um: FloatArray, rise: int, fall: int, noise_um: float) -> Pulse:
    """Measure the response, (N,), to a pulse that begins to rise and to fall at these samples."""
    before_um = float(displacement_um[:rise].mean())
    quarter = max(1, (fall - rise) // 4)
    top_um = float(displacement_um[fall - quarter:fall].mean())
    third_um = float(displacement_um[fall - 2 * quarter:fall - quarter].mean())
    after_um = float(displacement_um[-quarter:].mean())
    excursion_um = displacement_um - before_um
    rise_um = top_um - before_um
    return Pulse(
        rise_um, top_um - after_um, max(0.0, float(excursion_um.max()) - 4.0 * noise_um),
        max(0.0, -float(excursion_um.min()) - 4.0 * noise_um),
        abs(top_um - third_um) / max(abs(rise_um), noise_um))


def measure_response(displacement_um: FloatArray, rises: Sequence[int], dwell: int, rest: Rest,
                     sample_period_s: float) -> StepResponse:
    """Average the responses, (N,), to equal pulses, and decompose the mean into exponentials.

    The voltage rises at the samples `rises`, and each time falls `dwell` samples later.
    """
    up_um = np.mean([displacement_um[n:n + dwell] for n in rises], axis=0)
    down_um = np.mean([displacement_um[n + dwell:n + 2 * dwell] for n in rises], axis=0)
    mean_um = 0.5 * (up_um - down_um)
    # The sample at the step is measured before the voltage acts.
    height_um = float(mean_um[-max(1, dwell // 10):].mean() - mean_um[0])
    noise = rest.of_mean_um(2 * len(rises)) / abs(height_um)
    return step_response((mean_um - mean_um[0]) / height_um, noise, sample_period_s)


def measure_creep(time_s: FloatArray, displacement_um: FloatArray, steps_s: FloatArray,
                  noise_um: float) -> Creep:
    """Find how much and for how long a stage creeps after a step.

    The creep is a sum of relaxations with time constants an octave apart and amplitudes of one
    sign. The creep of earlier steps is superposed (Boltzmann). Times, (N,), count from the last
    step, and are negative before it; `steps_s` are those of all steps, alternately up and down.
    """
    displacement_um = displacement_um - displacement_um[time_s < 0.0].mean()
    after = time_s > 0.0
    sign = np.sign(displacement_um[after].mean())
    first_s, last_s = time_s[after][0], time_s[-1]
    constants_s = first_s * 2.0 ** np.arange(np.log2(4.0 * last_s / first_s))
    ups = (-1.0) ** np.arange(steps_s.size)[::-1]
    relaxed = sum(up * -np.expm1(-np.maximum(time_s - step_s, 0.0)[:, None] / constants_s)
                  for up, step_s in zip(ups, steps_s, strict=True))
    # Each octave of time has the same weight, although later ones hold more samples.
    weights = 1.0 / np.sqrt(np.maximum(np.abs(time_s), first_s))
    columns = np.column_stack([np.ones_like(time_s), after, sign * relaxed])
    bounds = [-np.inf, -np.inf] + [0.0] * constants_s.size
    fit = lsq_linear(columns * weights[:, None], displacement_um * weights, (bounds, np.inf)).x
    ends_s = last_s / 2.0 ** np.arange(np.floor(np.log2(last_s / first_s)))[::-1]
    crept = -np.expm1(-ends_s[:, None] / constants_s) @ fit[2:] / abs(fit[1])
    octaves = np.diff(crept)
    samples = 0.5 * ends_s[1:] / (last_s / np.count_nonzero(after))
    spread = noise_um / abs(fit[1]) * np.sqrt(2.0 / samples)
    much = octaves > np.maximum(
        ENDED * octaves.max(initial=0.0), np.maximum(LEAST_CREEP, 4.0 * spread))
    decades = np.log10(ends_s[-1] / ends_s[0])
    return Creep(float((crept[-1] - crept[0]) / decades), float(
        ends_s[1:][much].max(initial=0.0)), not much[-1])
