# SPDX-License-Identifier: BSD-3-Clause
"""The schema of the weights file of the feedback design."""

from typing import ClassVar

from pydantic import model_validator

from piezo_common.schema import Document, Number, Numbers, Part, entry, violation


class WeightEntry(Part):
    """The weight ``gain * prod(z - zero) / prod(z - pole)`` at the tick rate."""

    gain: Number = entry("Gain.", above=0.0)
    zeros: Numbers = entry("Zeros in the plane of z, no more than poles.")
    poles: Numbers = entry("Poles in the plane of z, each inside the unit circle.")

    @model_validator(mode="after")
    def _check_proper_and_stable(self) -> "WeightEntry":
        if len(self.zeros) > len(self.poles):
            raise violation("has more zeros than poles", "give as many poles")
        for i, pole in enumerate(self.poles):
            if abs(pole) >= 1:
                raise violation("lies on or outside the unit circle, for which no controller "
                                "exists", "use 0.9995 for integral action", f"poles[{i}]")
        return self


class WeightsDocument(Document):
    """The weights file: the requirements on the feedback loop over frequency."""

    TITLE: ClassVar[str] = "weights file"
    SYNTAX: ClassVar[str] = "yaml"
    RENEW: ClassVar[str] = "add it, as in the weights that come with the package"

    sample_period_s: Number = entry("Tick that the weights are written for.", unit="s", above=0.0)
    performance: WeightEntry = entry("Weight w1 of the tracking error, (5.15).")
    control: WeightEntry = entry("Weight w2 of the control voltage, (5.15).")
    reference: WeightEntry = entry("Weight w_r of the reference, (5.16).")
    noise: WeightEntry = entry("Weight w_n of the sensor's noise, (5.16).")
    disturbance: WeightEntry = entry("Weight w_d of the disturbance, (5.16).")
    feedforward_error: Number = entry("Error w_delta of the feedforward, (5.12).", above=0.0)
    hysteresis_uncertainty: Number = entry(
        "The hysteresis' gain lies within 1 +- w_u of its nominal value.", above=0.0)
