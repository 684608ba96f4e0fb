# SPDX-License-Identifier: BSD-3-Clause
"""What a model says a recording should have measured, and how far it is off."""

from dataclasses import dataclass

import control
import numpy as np

from piezo_identification.settling import settling_time_s
from piezo_identification.waveforms import played, samples_per_mean, turning_points
from piezo_models.linear import equilibrium_state, simulate_linear, zoh
from piezo_models.measures import e_y_percent

SLOW_BRANCH_S = 0.05
"""A way between two reversals that takes longer shows hysteresis, a shorter one dynamics."""


@dataclass(frozen=True)
class Prediction:
    """Measured and simulated displacement of the part in which the waveform plays.

    Parameters
    ----------
    time_s, voltage_v, measured_um, simulated_um : ndarray, shape (N,)
        From when the start has settled.
    """

    time_s: np.ndarray
    voltage_v: np.ndarray
    measured_um: np.ndarray
    simulated_um: np.ndarray

    @property
    def is_reversed(self):
        """True if the measured displacement moves against the simulated one."""
        return bool(np.dot(self.measured_um - self.measured_um.mean(), self.simulated_um) < 0.0)

    def e_y_percent(self, part=slice(None)):
        """Relative error (4.20) by the sensor, offset removed, of the whole or of a part."""
        return e_y_percent(self.measured_um[part], self.simulated_um[part])


def predict(model, recording):
    """Simulate a model under the voltage of a recording.

    The state of the creep at the first sample, and the offset, are fitted: nothing tells what the
    stage did before. The hysteresis is taken to come from negative saturation.

    Parameters
    ----------
    model : StageModel
    recording : Recording

    Returns
    -------
    Prediction

    Raises
    ------
    ValueError
        If the recording has gaps, or is too short to settle.
    """
    part = played(recording)
    before = recording.select(recording.sample_index <= part.sample_index[0]).voltage_v
    past = model.hysteresis.memory()
    model.hysteresis.simulate(before, past)
    memory = model.memory(hysteresis=past)
    voltage_v = model.amplified(part.voltage_v, part.sample_period_s)
    hysteresis_um = model.hysteresis.simulate(voltage_v, memory.hysteresis)
    rates_rad_per_s = list(model.creep.poles_rad_per_s)
    if model.hysteretic_creep is not None:
        hysteresis_um += model.hysteretic_creep.simulate(
            voltage_v, part.sample_period_s, memory.hysteretic_creep
        )
        rates_rad_per_s += [1.0 / tau for tau in set(model.hysteretic_creep.time_constants_s)]
    linear = model.linear()
    simulated_um = model.sensed(
        simulate_linear(
            mean_zoh(linear, part.sample_period_s, samples_per_mean(part)), hysteresis_um,
            equilibrium_state(linear, hysteresis_um[0]),
        ),
        part.sample_period_s,
    )
    settled = np.flatnonzero(part.time_s >= settling_time_s(model.dynamics))
    free = np.column_stack([
        np.ones(settled.size),
        *(np.exp(-p * part.time_s[settled]) for p in rates_rad_per_s),
    ])
    if settled.size <= free.shape[1]:
        raise ValueError(f"{recording.path} has {part.time_s.size} samples: record longer")
    difference_um = part.displacement_um[settled] - simulated_um[settled]
    initial = np.linalg.lstsq(free, difference_um, rcond=1e-12)[0]
    return Prediction(
        part.time_s[settled], part.voltage_v[settled], part.displacement_um[settled],
        simulated_um[settled] + free @ initial,
    )


def unseen_errors(model, recording):
    """Errors on a recording that was not fitted, by the sensor.

    Parameters
    ----------
    model : StageModel
    recording : Recording

    Returns
    -------
    dict of str to float
        `e_y_percent` of the whole, `hysteresis_e_y_percent` of the slow branches and
        `dynamics_e_y_percent` of the fast ones, as far as there are any.
    """
    prediction = predict(model, recording)
    errors = {"e_y_percent": prediction.e_y_percent()}
    slow = slow_branches(prediction.time_s, prediction.voltage_v)
    for name, part in (("hysteresis", slow), ("dynamics", ~slow)):
        if np.ptp(prediction.measured_um[part], axis=None) if part.any() else 0.0:
            errors[f"{name}_e_y_percent"] = prediction.e_y_percent(part)
    return errors


def slow_branches(time_s, voltage_v):
    """Mask of the samples between reversals that are longer than `SLOW_BRANCH_S` apart."""
    points = turning_points(voltage_v, 1e-3 * np.ptp(voltage_v))
    slow = np.zeros(voltage_v.size, dtype=bool)
    for start, end in zip(points[:-1], points[1:], strict=True):
        slow[start : end + 1] = time_s[end] - time_s[start] > SLOW_BRANCH_S
    return slow


def mean_zoh(system, sample_period_s, samples):
    """Discrete system whose output is the mean of the samples that fall into each held period.

    Parameters
    ----------
    system : control.StateSpace
        Continuous.
    sample_period_s : float
        Time for which the input is held.
    samples : int
        Equally spaced output samples in that time, the first at its start.

    Returns
    -------
    control.StateSpace
        Discrete, with the state of `system` at the start of each period.
    """
    fine = zoh(system, sample_period_s / samples)
    transition, gain = np.eye(system.nstates), np.zeros_like(fine.B)
    output, direct = np.zeros_like(fine.C), np.zeros_like(fine.D)
    for _ in range(samples):
        output, direct = output + fine.C @ transition, direct + fine.C @ gain + fine.D
        transition, gain = fine.A @ transition, fine.A @ gain + fine.B
    return control.ss(transition, gain, output / samples, direct / samples, sample_period_s)
