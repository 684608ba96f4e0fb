# SPDX-License-Identifier: BSD-3-Clause
"""What remains of each recording, held to the least noise that is known of its sensor."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from piezo_identification.adequacy.lack_of_fit import SETTINGS as ADEQUACY
from piezo_identification.diagnosis.evidence.known_noise import KnownNoise
from piezo_identification.diagnosis.joint.expected_errors import errors_of_model
from piezo_identification.diagnosis.joint.probabilities import (
    SETTINGS,
    SOMETHING_ELSE,
    odds_of_something_else,
)
from piezo_identification.fitting.model_weights import Remainder
from piezo_identification.fitting.regression import SETTINGS as FIT


@dataclass(frozen=True)
class HeldToNoise:
    """Probabilities after what remains was held to the noise.

    Attributes
    ----------
    probabilities : dict of str to float
        The largest first.
    sentence : str
        How many times the noise remains, and what shows the noise.
    """

    probabilities: dict[str, float]
    sentence: str


def held_to_noise(shares: Mapping[str, float], remainders: Sequence[Remainder], known: KnownNoise,
                  stated_um: float, finds_nothing: bool) -> HeldToNoise:
    """Return how probable something else is, where remainders are held to the least known noise.

    Parameters
    ----------
    shares : dict of str to float
        Probabilities by the noise that each recording shows itself.
    remainders : sequence of Remainder
        Of the recordings that are diagnosed, and of the one that is held out.
    known : KnownNoise
        With one source at least.
    stated_um : float
        RMS of what the model is known to be wrong by.
    finds_nothing : bool
        No effect is named. Components that the identification called inadequate then excuse no more
        than the noise: what remains beyond it must pass the identification's own tolerance.
    """
    contradicts = finds_nothing and bool(known.inadequate)
    tolerance = ADEQUACY.tolerance if contradicts else FIT.model_tolerance
    sources = [known.least(each.period_s) for each in remainders]
    noise_um = np.array([source.rms_um for source in sources])
    accuracy_um = np.array([tolerance * each.travel_um for each in remainders])
    left = np.array([each.held_out.mean_square_um2 for each in remainders])
    samples = np.array([min(each.held_out.independent, SETTINGS.most_effective)
                        for each in remainders])
    before = shares.get(SOMETHING_ELSE, 0.0)
    listed = {name: share for name, share in shares.items() if name != SOMETHING_ELSE}
    whole = sum(listed.values())
    odds = odds_of_something_else(left, samples, errors_of_model(
        noise_um, accuracy_um, np.array([each.motion_um for each in remainders]),
        np.minimum(stated_um, noise_um) if contradicts else stated_um))
    odds *= max(listed.values(), default=0.0) / whole if whole > 0.0 else 1.0
    other = max(before, odds / (1.0 + odds))
    kept = {name: share * (1.0 - other) / whole if whole > 0.0 else 0.0
            for name, share in listed.items()} | {SOMETHING_ELSE: other}
    worst = int(np.argmax(left / noise_um**2))
    sentence = (
        f"What remains of {remainders[worst].name} is {np.sqrt(left[worst]) / noise_um[worst]:.3g} "
        f"times the noise of {1e3 * sources[worst].rms_um:.3g} nm RMS that "
        f"{sources[worst].name} shows.")
    if contradicts:
        sentence += (f" The identification already called inadequate: "
                     f"{', '.join(known.inadequate)}.")
    return HeldToNoise(
        dict(sorted(kept.items(), key=lambda entry: -entry[1])), sentence)
