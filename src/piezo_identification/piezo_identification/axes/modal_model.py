# SPDX-License-Identifier: BSD-3-Clause
"""Models of several axes from the numbers of their modes."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_identification.axes.coupled_numbers import CoupledNumbers
from piezo_models.axes.actuator import Actuator
from piezo_models.axes.coupled import CoupledModel
from piezo_recorder.reading.axes import AxesRecording


def coupled_model(numbers: CoupledNumbers, late: np.ndarray, driven: Sequence[AxesRecording],
                  actuators: tuple[Actuator, ...] = ()) -> CoupledModel:
    """Return the model of some numbers, without softening.

    The latency of each sensor is given, (n,), and fast recordings with the drive in place of their
    voltage.
    """
    first, samples = driven[0], [len(each.voltage_v) for each in driven]
    voltage_v, displacement_um = (
        np.average([np.mean(signal, axis=0) for signal in signals], axis=0, weights=samples)
        for signals in zip(*((each.voltage_v, each.displacement_um) for each in driven),
                           strict=True))
    return replace(modal_model(numbers, late, first.axes, first.sample_period_s),
                   operating_voltage_v=voltage_v, operating_displacement_um=displacement_um,
                   actuators=actuators)


def modal_model(numbers: CoupledNumbers, late: np.ndarray, axes: tuple[str, ...],
                sample_period_s: float) -> CoupledModel:
    """Return the model of some numbers about zero, without softening."""
    poles = (np.log(numbers.steps) / sample_period_s).astype(complex)
    return CoupledModel(
        axes, sample_period_s, poles, residues_of(numbers, numbers.gains), numbers.direct, late,
        np.zeros(len(axes)), np.zeros(len(axes)))


def residues_of(numbers: CoupledNumbers, gains: FloatArray) -> ComplexArray:
    """Return the residues that gains of `mode_basis` stand for, one of each pair first."""
    pairs = 2 * int(np.count_nonzero(numbers.steps.imag > 0.0))
    return np.concatenate([gains[0:pairs:2] + 1j * gains[1:pairs:2], gains[pairs:].astype(complex)])
