# SPDX-License-Identifier: BSD-3-Clause
"""Comparison of the residual of each recording with the smallest known noise of its sensor.

If no recording shows the noise, the residual may or may not be noise. A part of it that follows
from the voltage is not: that part is compared with the accuracy of a good model.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from piezo_identification.diagnosis.comparison.criteria import CRITERIA
from piezo_identification.diagnosis.evidence.known_noise import KnownNoise
from piezo_identification.diagnosis.joint.probabilities import (
    BELIEVED,
    SOMETHING_ELSE,
    errors_of_model,
    odds_of_something_else,
)
from piezo_identification.fitting.evidence import INDEPENDENT
from piezo_identification.fitting.model_weights import Remainder
from piezo_identification.fitting.regression import SETTINGS as FIT

if TYPE_CHECKING:
    from piezo_identification.diagnosis.evidence.ceiling import Ceiling


@dataclass(frozen=True)
class HeldToNoise:
    """Probabilities after the residual was compared with the noise."""

    probabilities: dict[str, float]
    """In descending order."""
    sentence: str
    """Sentence on the residual relative to the noise, and on the source of the noise."""
    predicted: "Ceiling | None" = None
    """Predictable part of the residual; None if not computed."""

    @property
    def is_explained(self) -> bool:
        """Return whether something else than the compared effects is improbable."""
        return self.probabilities[SOMETHING_ELSE] < BELIEVED


def held_to_noise(shares: Mapping[str, float], remainders: Sequence[Remainder], known: KnownNoise,
                  stated_um: float, finds_nothing: bool) -> HeldToNoise:
    """Return the probability of something else, from residuals relative to the known noise.

    `shares` are the probabilities based on the noise that each recording shows itself. The known
    noise has at least one source. If no effect is named (`finds_nothing`), and the identification
    found components inadequate, the error of the model is limited to the noise, and the tolerance
    of the identification applies.
    """
    contradicts = finds_nothing and bool(known.inadequate)
    tolerance = FIT.adequate_tolerance if contradicts else FIT.model_tolerance
    sources = [known.least(each.period_s) for each in remainders]
    noise_um = np.array([source.rms_um for source in sources])
    accuracy_um = np.array([tolerance * each.travel_um for each in remainders])
    squares_um2 = np.array([each.held_out.mean_square_um2 for each in remainders])
    samples = np.array([min(each.held_out.independent, INDEPENDENT)
                        for each in remainders])
    odds = odds_of_something_else(squares_um2, samples, errors_of_model(
        noise_um, accuracy_um, np.array([each.motion_um for each in remainders]),
        np.minimum(stated_um, noise_um) if contradicts else stated_um))
    worst = int(np.argmax(squares_um2 / noise_um**2))
    sentence = (
        f"What remains of {remainders[worst].name} is "
        f"{np.sqrt(squares_um2[worst]) / noise_um[worst]:.3g} times the noise of "
        f"{1e3 * sources[worst].rms_um:.3g} nm RMS that "
        f"{sources[worst].name} shows.")
    if contradicts:
        sentence += (f" The identification already called inadequate: "
                     f"{', '.join(known.inadequate)}.")
    return HeldToNoise(_with_other_odds(shares, odds), sentence)


def held_to_prediction(held: HeldToNoise, predicted: "Ceiling", remainders: Sequence[Remainder],
                       stated_um: float) -> HeldToNoise:
    """Return the probability of something else if the noise of the sensor is unknown.

    The residual was compared with the smallest bound of the noise before.
    """
    # Less than a learner may predict from noise by chance, or than is relevant.
    least_um = CRITERIA.noticeable * predicted.left_um
    largest = max(remainders, key=lambda each: each.travel_um)
    samples = min(sum(each.held_out.independent for each in remainders), INDEPENDENT)
    odds = odds_of_something_else(
        np.array([predicted.from_voltage_um**2]), np.array([samples]), errors_of_model(
            np.array([least_um]), np.array([FIT.model_tolerance * largest.travel_um]),
            np.array([largest.motion_um]), stated_um))
    follows = "nothing follows from the voltage"
    if predicted.from_voltage_um > 0.0:
        follows = (f"{1e3 * predicted.from_voltage_um:.3g} nm follow from the voltage, and are no "
                   "noise")
    sentence = (
        "No recording at hand shows the noise of the sensor: none of them rests, repeats or is "
        f"sampled much faster than it moves. Of the {1e3 * predicted.left_um:.3g} nm RMS that "
        f"remain, {follows}. A second in which the voltage rests shows how much of them is noise.")
    return HeldToNoise(_with_other_odds(held.probabilities, odds), sentence, predicted)


def _with_other_odds(shares: Mapping[str, float], odds: float) -> dict[str, float]:
    """Return probabilities with that of something else increased to match its odds to the best."""
    before = shares.get(SOMETHING_ELSE, 0.0)
    listed = {name: share for name, share in shares.items() if name != SOMETHING_ELSE}
    whole = sum(listed.values())
    odds *= max(listed.values(), default=0.0) / whole if whole > 0.0 else 1.0
    other = max(before, odds / (1.0 + odds))
    kept = {name: share * (1.0 - other) / whole if whole > 0.0 else 0.0
            for name, share in listed.items()} | {SOMETHING_ELSE: other}
    return dict(sorted(kept.items(), key=lambda entry: -entry[1]))
