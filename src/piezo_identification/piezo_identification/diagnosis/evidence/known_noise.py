# SPDX-License-Identifier: BSD-3-Clause
"""The smallest noise of a sensor that any available recording shows.

A recording without a rest or a repeat cannot distinguish errors of the model from noise. Another
recording of the same sensor can. A row of a slow recording may be the mean of many samples, so that
its noise may be smaller than that of faster rows, by the square root of the ratio of the sample
periods.

A recording that does not show the noise provides an upper bound.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_identification.adequacy.component_adequacy import INADEQUATE
from piezo_identification.conditioning.sensor_noise import (
    noise_floor_um,
    noise_from_repeats_um,
    noise_from_rest_um,
    repeated_period,
    shows_noise,
)
from piezo_identification.conditioning.waveforms import played
from piezo_identification.fitting.regression import Regression
from piezo_models.identified_model import IdentifiedModel
from piezo_recorder.reading.recording import Recording

MOST_SAMPLES = 200_000
"""The noise of longer recordings is estimated from their first samples."""

OF_MEANS = "repeats"
"""If the noise of a component comes from repeats, it is that of their mean, and their number is not
in the model file."""
OF_RESTS = "rests"
"""If it comes from rests, it is known; otherwise it is the residual in the quietest band."""


@dataclass(frozen=True)
class NoiseSource:
    """Noise as shown by one recording."""

    rms_um: float

    period_s: float
    """Sample period of its rows."""
    name: str
    """Name of the source."""
    is_shown: bool = True
    """False if the value is only an upper bound."""

    def at(self, period_s: float) -> "NoiseSource":
        """Return the upper bound of the noise for rows of another sample period."""
        faster = max(1.0, self.period_s / period_s)
        return replace(self, rms_um=self.rms_um * float(np.sqrt(faster)), period_s=period_s,
                       is_shown=self.is_shown and bool(np.isclose(faster, 1.0)))


@dataclass(frozen=True)
class KnownNoise:
    """Known noise of a sensor, and components of the model with larger residuals."""

    sources: tuple[NoiseSource, ...] = ()

    inadequate: tuple[str, ...] = ()
    """Components that the identification found inadequate."""

    def least(self, period_s: float) -> NoiseSource:
        """Return the smallest known noise for rows of a sample period; there must be a source."""
        return min((source.at(period_s) for source in self.sources),
                   key=lambda source: source.rms_um)

    def is_shown(self, period_s: float) -> bool:
        """Return whether the noise for a sample period is known, not only bounded."""
        return any(source.at(period_s).is_shown for source in self.sources)

    def including(self, sources: Sequence[NoiseSource]) -> "KnownNoise":
        """Return the noise with more sources."""
        return replace(self, sources=(*self.sources, *sources))


def noise_of_model(identified: IdentifiedModel) -> KnownNoise:
    """Return the noise that a model file states for its recordings."""
    adequacy, periods_s = identified.adequacy, identified.sample_periods_s
    return KnownNoise(
        tuple(NoiseSource(part["noise_rms_um"], periods_s[name], f"the model file for {name}",
                          part["noise_from"] == OF_RESTS)
              for name, part in adequacy.items()
              if name in periods_s and part.get("noise_from", OF_MEANS) != OF_MEANS
              and part["noise_rms_um"] > 0.0),
        tuple(name for name, part in adequacy.items() if part["verdict"] == INADEQUATE))


def noise_of_residuals(regression: Regression) -> list[NoiseSource]:
    """Return the noise that each recording of a regression shows with the model."""
    return [NoiseSource(noise_um, part.sample_period_s, f"the residual of {recording.path}",
                        shows_noise(part.measured_um[part.begin :], part.voltage_v[part.begin :]))
            for recording, part, noise_um in zip(
                regression.dataset.recordings, regression.dataset.simulated,
                regression.noise.noise_um, strict=True)]


def noise_sources(recordings: Sequence[Recording]) -> list[NoiseSource]:
    """Return the noise that each recording shows without any model."""
    found = []
    for recording in recordings:
        part = played(recording)
        signals = [np.asarray(each, dtype=float)[:MOST_SAMPLES]
                   for each in (part.displacement_um, part.voltage_v)]
        noise_um = _noise_um(*signals)
        if noise_um > 0.0:
            found.append(NoiseSource(
                noise_um, part.sample_period_s, str(recording.path), shows_noise(*signals)))
    return found


def _noise_um(displacement_um: FloatArray, voltage_v: FloatArray) -> float:
    """Return the noise between repeats or at rest, otherwise in the quietest band.

    A digital sensor may not change at rest; its noise is then at least that of its steps.
    """
    period = repeated_period(voltage_v)
    found = [noise_from_rest_um(displacement_um, voltage_v),
             noise_from_repeats_um(displacement_um, period) if period else None]
    noise_um = min((noise for noise in found if noise), default=0.0) or noise_floor_um(
        displacement_um - displacement_um.mean())
    steps_um = np.diff(np.unique(displacement_um))
    return max(noise_um, float(steps_um.min()) / np.sqrt(12.0) if steps_um.size else 0.0)
