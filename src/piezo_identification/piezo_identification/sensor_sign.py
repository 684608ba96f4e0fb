# SPDX-License-Identifier: BSD-3-Clause
"""The direction in which the sensor counts: models rise with the voltage."""

from dataclasses import replace

import numpy as np

from piezo_identification.waveforms import played


def displacement_falls(recording):
    """True if the displacement falls, on the whole, as the voltage rises.

    Parameters
    ----------
    recording : Recording
        Of a voltage that is slow beside the vibrations.
    """
    part = played(recording)
    voltage_v = part.voltage_v - part.voltage_v.mean()
    return bool(voltage_v @ (part.displacement_um - part.displacement_um.mean()) < 0.0)


def reversed_displacement(recording):
    """The recording with the sign of its displacement changed."""
    return replace(recording, displacement_um=np.negative(recording.displacement_um))
