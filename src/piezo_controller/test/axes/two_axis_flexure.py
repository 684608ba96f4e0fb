# SPDX-License-Identifier: BSD-3-Clause
"""A flexure of two axes that the tests play voltages on: three modes that both share, late sensors.

It is simulated mode by mode at ten times the sample rate, and shares no code with the models.
"""

import control
import numpy as np
from scipy.linalg import expm
from scipy.signal import cont2discrete, lfilter

from piezo_models import CoupledModel, Coupling, IdentifiedAxes

PERIOD_S = 25e-6
FINER = 10
FREQUENCY_HZ = np.array([310.0, 365.0, 720.0])
DAMPING = np.array([0.012, 0.015, 0.02])
LATE = (3, 16)
"""By which the sensors are late, in tenths of a sample period."""

COUPLED = 10.0 ** (-30.0 / 20.0)
PUSH = np.array([[1.0, -0.04], [0.05, 1.0], [0.15, 0.3]])
STATIC_UM_PER_V = 0.25 * np.array([[1.0, COUPLED], [-COUPLED, 0.9]])
# By axis and mode; the third shape is given, the others follow from the static response.
YAW = np.array([0.1, 0.12])
SHAPES = np.column_stack([
    (STATIC_UM_PER_V - np.outer(YAW, PUSH[2])) @ np.linalg.inv(PUSH[:2]), YAW])


def played_um(voltage_v):
    """Return the samples of both sensors under voltages from rest at 0 V, each held."""
    fine_v = np.repeat(voltage_v, FINER, axis=0)
    moved_um = np.zeros((len(fine_v), 2))
    for frequency_hz, damping, push, shape in zip(FREQUENCY_HZ, DAMPING, PUSH, SHAPES.T,
                                                  strict=True):
        omega = 2.0 * np.pi * frequency_hz
        b, a, _ = cont2discrete(([omega**2], [1.0, 2.0 * damping * omega, omega**2]),
                                PERIOD_S / FINER)
        moved_um += np.outer(lfilter(b[0], a, fine_v @ push), shape)
    return np.column_stack([
        np.r_[np.zeros(late), column][: len(column)][::FINER]
        for late, column in zip(LATE, moved_um.T, strict=True)])


def model(frequency_off=(0.0, 0.0, 0.0), damping_off=0.0, push_off=0.0):
    """Return the model of the flexure by python-control, with relative errors."""
    omega = 2.0 * np.pi * FREQUENCY_HZ * (1.0 + np.array(frequency_off))
    damping = DAMPING * (1.0 + damping_off)
    a = np.block([[np.zeros((3, 3)), np.eye(3)],
                  [-np.diag(omega**2), -np.diag(2.0 * damping * omega)]])
    b = np.vstack([np.zeros((3, 2)), omega[:, None] ** 2 * PUSH * (1.0 + push_off)])
    c = np.hstack([SHAPES, np.zeros((2, 3))])
    rows = []
    for sensor, late in enumerate(LATE):
        whole = -(-late // FINER)
        on, push = _held(a, b, (whole - late / FINER) * PERIOD_S)
        seen = control.ss(*_held(a, b, PERIOD_S), c[[sensor]] @ on, c[[sensor]] @ push, PERIOD_S)
        rows.append(control.ss(control.tf([1.0], [1.0] + [0.0] * whole, PERIOD_S)) * seen)
    both = control.ss(control.append(*rows)) * control.ss(
        [], [], [], np.vstack([np.eye(2), np.eye(2)]), PERIOD_S)
    return CoupledModel.from_control(both, ("x", "y"))


def identified(largest_v):
    """Return the model as it is identified with voltages of either sign."""
    exact = model()
    frequency_hz, modes = np.geomspace(1.0, 1e4, 10), exact.poles_rad_per_s.size
    gain = exact.response(frequency_hz)
    return IdentifiedAxes(
        exact, largest_v * np.array([[-1.0, 1.0]] * 2),
        Coupling(frequency_hz, gain, 1e-3 * np.abs(gain)), np.zeros(modes, complex),
        1e-3 * exact.residues_um_per_v, np.zeros(2), np.zeros(2))


def _held(a, b, span_s):
    whole = expm(np.block([[a, b], [np.zeros((b.shape[1], len(a) + b.shape[1]))]]) * span_s)
    return whole[: len(a), : len(a)], whole[: len(a), len(a):]
