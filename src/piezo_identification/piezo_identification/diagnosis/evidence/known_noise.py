# SPDX-License-Identifier: BSD-3-Clause
"""The least noise of a sensor that any recording at hand shows.

A recording without a rest or a repeat cannot tell what a model lacks from noise. Another recording
of the same sensor can. A row of a slow recording may be the mean of many samples, so the noise that
it shows may be less than that of faster rows, by the root of the ratio of the sample periods.

A recording that does not show the noise bounds it from above, as it has no less noise than that.
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
"""The noise of longer recordings is that of their beginning."""

OF_MEANS = "repeats"
"""Where repeats told the noise of a component, it is that of their mean, and their number is not in
the model file."""
OF_RESTS = "rests"
"""Where rests told it, it is shown; else it is what the component left in its quietest band."""


@dataclass(frozen=True)
class NoiseSource:
    """Noise as one recording shows it.

    Attributes
    ----------
    rms_um : float
    period_s : float
        Sample period of its rows.
    name : str
        Of what shows it.
    is_shown : bool
        Else the noise may be any less.
    """

    rms_um: float
    period_s: float
    name: str
    is_shown: bool = True

    def at(self, period_s: float) -> "NoiseSource":
        """Return the most noise that rows of another sample period may have."""
        faster = max(1.0, self.period_s / period_s)
        return replace(self, rms_um=self.rms_um * float(np.sqrt(faster)), period_s=period_s,
                       is_shown=self.is_shown and bool(np.isclose(faster, 1.0)))


@dataclass(frozen=True)
class KnownNoise:
    """What is known of a sensor's noise, and which components of the model leave more.

    Attributes
    ----------
    sources : tuple of NoiseSource
    inadequate : tuple of str
        Components that the identification called inadequate.
    """

    sources: tuple[NoiseSource, ...] = ()
    inadequate: tuple[str, ...] = ()

    def least(self, period_s: float) -> NoiseSource:
        """Return the least noise known for rows of a sample period; there is a source."""
        return min((source.at(period_s) for source in self.sources),
                   key=lambda source: source.rms_um)

    def is_shown(self, period_s: float) -> bool:
        """Tell whether the noise of rows of a sample period is known, and not only bounded."""
        return any(source.at(period_s).is_shown for source in self.sources)

    def beside(self, sources: Sequence[NoiseSource]) -> "KnownNoise":
        """Return the same with more sources."""
        return replace(self, sources=(*self.sources, *sources))


def noise_of_model(identified: IdentifiedModel) -> KnownNoise:
    """Return the noise that a model file tells of its recordings."""
    adequacy, periods_s = identified.adequacy, identified.sample_periods_s
    return KnownNoise(
        tuple(NoiseSource(part["noise_rms_um"], periods_s[name], f"the model file for {name}",
                          part["noise_from"] == OF_RESTS)
              for name, part in adequacy.items()
              if name in periods_s and part.get("noise_from", OF_MEANS) != OF_MEANS
              and part["noise_rms_um"] > 0.0),
        tuple(name for name, part in adequacy.items() if part["verdict"] == INADEQUATE))


def noise_of_residuals(regression: Regression) -> list[NoiseSource]:
    """Return the noise that each recording of a regression shows beside the model."""
    return [NoiseSource(noise_um, part.sample_period_s, f"{recording.path} beside the model",
                        shows_noise(part.measured_um[part.begin :], part.voltage_v[part.begin :]))
            for recording, part, noise_um in zip(
                regression.dataset.recordings, regression.dataset.simulated,
                regression.noise.noise_um, strict=True)]


def noise_sources(recordings: Sequence[Recording]) -> list[NoiseSource]:
    """Return the noise that each of some recordings shows without any model."""
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
    """Return the noise between repeats or at rest, or else in the quietest band.

    A sensor that counts steps may stand still at rest: it is no better than its steps are fine.
    """
    period = repeated_period(voltage_v)
    found = [noise_from_rest_um(displacement_um, voltage_v),
             noise_from_repeats_um(displacement_um, period) if period else None]
    noise_um = min((noise for noise in found if noise), default=0.0) or noise_floor_um(
        displacement_um - displacement_um.mean())
    steps_um = np.diff(np.unique(displacement_um))
    return max(noise_um, float(steps_um.min()) / np.sqrt(12.0) if steps_um.size else 0.0)
