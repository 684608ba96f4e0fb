# SPDX-License-Identifier: BSD-3-Clause
"""Voltages whose periodic answer of a coupled model is a path: the inverse, line by line.

Modes and coupling first, then creep and hysteresis of each axis.
"""

from typing import NamedTuple

import numpy as np

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_controller.axes.repeated_period import repeated
from piezo_models.axes.coupled import CoupledModel
from piezo_models.linear.periodic_inversion import used_lines

GAIN_LIMIT = 100.0
"""Voltage for a displacement, in multiples of that at rest, up to which a model is inverted. A
stage passes so little only far above its modes; there a smooth path has next to nothing, and no
model is known to a few percent."""

INVERSES = ("none", "diagonal", "coupled")
"""By the static gain of each axis alone; by the response of each axis; by the whole matrix."""

LINES_AT_ONCE = 1 << 15
"""Lines of the spectrum that are inverted together, which bounds the memory."""

ROUNDS, SAME_AMPLITUDE = 20, 1e-9
"""The softening follows from the voltage and the voltage from the softening: each round multiplies
the error by the few percent by which a stage softens."""

CORRECTIONS, CORRECTED = 8, 1e-6
"""At most, of what a softening that changes within a period leaves, and the part of the path at
which they end; each that helps is kept."""


class Inverted(NamedTuple):
    """Voltages of a path, each for a sample period, and what of it they leave out."""

    voltage_v: FloatArray
    """Shape (N, n)."""
    drive_v: FloatArray
    """Drive of the modes after hysteresis and creep, (N, n)."""
    missed_um: FloatArray
    """Part of the path that the limit of the gain leaves out, (N, n)."""
    amplitude_v: float
    """RMS of the drive about the operating point, at which the model softened."""


def invert_path(position_um: FloatArray, model: CoupledModel, inverse: str = "coupled",
                gain_limit: float = GAIN_LIMIT) -> Inverted:
    """Return the voltages, held between samples, whose steady displacement is a periodic path.

    The path has the shape (N, n), with all axes of the model. Each line of the path's spectrum is
    divided by the response of the sampled model at the amplitude of the voltages: exactly, up to a
    limit of the gain. Beyond it, the response relative to that at rest has a singular value below
    ``1 / gain_limit``, and the path is followed in proportion, without a shift of phase. Of
    `INVERSES`, none takes the voltage as the drive, hysteresis and creep or not.

    Raises ValueError if the axes of the model cannot be distinguished at rest, or a hysteresis has
    no inverse.
    """
    found = _inverted(position_um - model.operating_displacement_um, model, inverse, gain_limit,
                      None)
    for _ in range(ROUNDS if model.softening else 0):
        before = found.amplitude_v
        found = _inverted(position_um - model.operating_displacement_um, model, inverse,
                          gain_limit, before)
        if abs(found.amplitude_v - before) <= SAME_AMPLITUDE * before:
            break
    if model.softening and inverse == "coupled":
        return _corrected(position_um - found.missed_um, model, found, gain_limit)
    return found


def _corrected(wanted_um: FloatArray, model: CoupledModel, found: Inverted,
               gain_limit: float) -> Inverted:
    """Take off what the model, which softens and stiffens within a period, leaves of the path."""
    left_um = wanted_um - repeated(found.voltage_v, model)
    for _ in range(CORRECTIONS):
        if np.std(left_um) <= CORRECTED * np.std(wanted_um):
            break
        more = _inverted(left_um, model, "coupled", gain_limit, found.amplitude_v)
        drive_v = found.drive_v + more.drive_v - model.operating_voltage_v
        voltage_v = _ahead_of_actuators(drive_v, model)
        still_um = wanted_um - repeated(voltage_v, model)
        if np.std(still_um) >= np.std(left_um):
            break
        found, left_um = found._replace(voltage_v=voltage_v, drive_v=drive_v), still_um
    return found


def _inverted(offset_um: FloatArray, model: CoupledModel, inverse: str, gain_limit: float,
              amplitude_v: float | None) -> Inverted:
    """Return the voltages for displacements from the operating point at an amplitude."""
    samples = len(offset_um)
    lines = np.fft.rfft(offset_um, axis=0)
    used = used_lines(lines)
    voltage, missed = np.zeros_like(lines), np.zeros_like(lines)
    at_rest = _response(model, np.zeros(1), inverse, amplitude_v)[0].real
    for at in np.array_split(used, used.size // LINES_AT_ONCE + 1):
        frequency_hz = at / (samples * model.sample_period_s)
        voltage[at], missed[at] = _inverted_lines(
            lines[at], _response(model, frequency_hz, inverse, amplitude_v), at_rest, gain_limit)
    drive_v, missed_um = (np.fft.irfft(each, samples, axis=0) for each in (voltage, missed))
    whole_v = model.operating_voltage_v + drive_v
    voltage_v = whole_v if inverse == "none" else _ahead_of_actuators(whole_v, model)
    return Inverted(voltage_v, whole_v, missed_um, float(np.sqrt(np.mean(drive_v**2))))


def _ahead_of_actuators(drive_v: FloatArray, model: CoupledModel) -> FloatArray:
    """Return the voltages by which a period of the drive is repeated, (N, n)."""
    if not model.actuators:
        return drive_v
    return np.column_stack([
        actuator.inverse_v(np.ascontiguousarray(column), model.sample_period_s)
        for actuator, column in zip(model.actuators, drive_v.T, strict=True)])


def spectral_square(lines: ComplexArray | FloatArray, samples: int) -> FloatArray:
    """Return the mean squares of signals, by column, from their lines of `numpy.fft.rfft`."""
    twice = np.full(len(lines), 2.0)
    twice[0] = 1.0
    if samples % 2 == 0:
        twice[-1] = 1.0
    square: FloatArray = twice @ np.abs(lines) ** 2 / samples**2
    return square


def _response(model: CoupledModel, frequency_hz: FloatArray, inverse: str,
              amplitude_v: float | None) -> ComplexArray:
    own = np.eye(len(model.axes))
    if inverse == "none":
        at_rest = model.response(0.0, amplitude_v) * own
        return np.repeat(at_rest, frequency_hz.size, axis=0)
    response = model.response(frequency_hz, amplitude_v)
    return response if inverse == "coupled" else response * own


def _inverted_lines(lines: ComplexArray, response: ComplexArray, at_rest: FloatArray,
                    gain_limit: float) -> tuple[ComplexArray, ComplexArray]:
    """Return the spectra of the voltages and of what is left out of the path."""
    if np.linalg.cond(at_rest) > gain_limit:
        raise ValueError("the static response of the model moves its axes together: they cannot be "
                         "separated; identify each of them by a recording in which it moves alone")
    still = np.linalg.inv(at_rest)
    left, passed, right = np.linalg.svd(still @ response)
    along = left.conj().transpose(0, 2, 1) @ (lines @ still.T)[:, :, None]
    gain = np.minimum(1.0 / np.maximum(passed, np.finfo(float).tiny), gain_limit)[:, :, None]
    voltage = right.conj().transpose(0, 2, 1) @ (gain * along)
    missed = left @ ((1.0 - gain * passed[:, :, None]) * along)
    return voltage[:, :, 0], (missed[:, :, 0]) @ at_rest.T
