# SPDX-License-Identifier: BSD-3-Clause
"""A flexure of two axes for tests: three modes that both share, sensors out of square and late."""

import numpy as np
from scipy.linalg import expm
from scipy.signal.windows import tukey

from piezo_recorder.reading.axes import axes_recordings_in

PERIOD_S = 1e-4
NOISE_UM = 0.003
COUPLED = 10.0 ** (-35.0 / 20.0)
OUT_OF_SQUARE_RAD = 0.005
LATE = (0.3, 1.6)
"""Sample periods by which the sensors are late."""

# Masses over one another: the stage in x, in y, and its yaw about the middle.
FREQUENCY_RAD_PER_S = 2.0 * np.pi * np.array([310.0, 365.0, 720.0])
DAMPING = np.array([0.012, 0.015, 0.02])
SHAPES = np.array([[1.0, 0.05, 0.2], [-0.06, 1.0, 0.25]])
PUSH = np.array([[1.0, -0.03], [0.04, 1.0], [0.15, 0.3]])
STATIC_UM_PER_V = np.array([[0.20, 0.20 * COUPLED], [-0.18 * COUPLED, 0.18]])


def continuous(softer=1.0, damped=1.0):
    """Return A, B, C of the motion at the sensors, in um and V.

    Parameters
    ----------
    softer, damped : float
        By which the stiffness and the damping are multiplied.
    """
    zeros = np.zeros((3, 3))
    a = np.block([[zeros, np.eye(3)],
                  [-softer * np.diag(FREQUENCY_RAD_PER_S**2),
                   -damped * np.diag(2.0 * DAMPING * FREQUENCY_RAD_PER_S)]])
    # The modes as scaled by their frequencies, then all so that the static response is as told.
    b = np.vstack([np.zeros((3, 2)), FREQUENCY_RAD_PER_S[:, None] ** 2 * PUSH])
    turned = np.array([[1.0, 0.0], [OUT_OF_SQUARE_RAD, 1.0]])
    c = np.hstack([turned @ STATIC_UM_PER_V @ np.linalg.inv(SHAPES @ PUSH) @ SHAPES,
                   np.zeros((2, 3))])
    return a, b, c


def held(a, b, span_s):
    """Return how a state goes on under a held voltage."""
    whole = expm(np.block([[a, b], [np.zeros((b.shape[1], a.shape[0] + b.shape[1]))]]) * span_s)
    return whole[: len(a), : len(a)], whole[: len(a), len(a):]


def motion_um(voltage_v):
    """Return the samples of both sensors from rest, without noise."""
    a, b, c = continuous()
    step, drive = held(a, b, PERIOD_S)
    samples = len(voltage_v)
    states = np.zeros((samples + 1, len(a)))
    for n in range(samples):
        states[n + 1] = step @ states[n] + drive @ voltage_v[n]
    found = np.zeros((samples, 2))
    for sensor, late in enumerate(LATE):
        whole = int(late) + 1
        on, push = held(a, b, (whole - late) * PERIOD_S)
        seen = states[:-1] @ (c[sensor] @ on) + voltage_v @ (c[sensor] @ push)
        found[whole:, sensor] = seen[:-whole]
    return found


def response(frequency_hz, softer=1.0, damped=1.0):
    """Return the response of the samples, (F, 2, 2); see `continuous`."""
    a, b, c = continuous(softer, damped)
    step, drive = held(a, b, PERIOD_S)
    found = np.zeros((len(frequency_hz), 2, 2), dtype=complex)
    z = np.exp(2j * np.pi * np.asarray(frequency_hz) * PERIOD_S)[:, None, None]
    states = np.linalg.solve(z * np.eye(len(a)) - step, drive)
    for sensor, late in enumerate(LATE):
        whole = int(late) + 1
        on, push = held(a, b, (whole - late) * PERIOD_S)
        found[:, sensor] = z[:, 0] ** -whole * (c[sensor] @ (on @ states + push))
    return found


def multisine_v(samples, rng, amplitude_v=5.0, highest_hz=2500.0):
    """Return a random-phase multisine that rises and falls at its ends."""
    lines = np.fft.rfftfreq(samples, PERIOD_S)
    spectrum = np.where((lines > 0.0) & (lines < highest_hz),
                        np.exp(2j * np.pi * rng.random(lines.size)), 0.0)
    voltage_v = np.fft.irfft(spectrum, samples) * tukey(samples, 0.05)
    return amplitude_v * voltage_v / np.std(voltage_v)


def table(voltage_v, rng):
    """Return the columns of a measured table."""
    measured = motion_um(voltage_v) + NOISE_UM * rng.normal(size=voltage_v.shape)
    return {"time_s": PERIOD_S * np.arange(len(voltage_v)),
            "x_voltage_v": voltage_v[:, 0] + 50.0, "y_voltage_v": voltage_v[:, 1] + 40.0,
            "x_displacement_um": measured[:, 0] + 10.0, "y_displacement_um": measured[:, 1] + 7.0}


def experiments(samples=4096, seed=1):
    """Return tables in which x moves, y moves, and both do."""
    rng = np.random.default_rng(seed)
    drives = [multisine_v(samples, rng)[:, None] * [[1.0, 0.0]],
              multisine_v(samples, rng)[:, None] * [[0.0, 1.0]],
              np.column_stack([multisine_v(samples, rng), multisine_v(samples, rng)])]
    return [table(each, rng) for each in drives]


LEVELS_V = (1.0, 2.0, 3.0)
SOFTER, DAMPED = (1.0, 0.98, 0.965), (1.0, 1.1, 1.18)
"""Stiffness and damping at each level: they change by more than a mode is wide."""


def periods(realisations, seed, samples=4096):
    """Return arrays (samples, axes, realisations, 2 periods) for each level."""
    rng = np.random.default_rng(seed)
    lines = np.arange(samples // 2 + 1)
    played = (lines > 0) & (lines < 0.45 * samples)
    levels = []
    for level_v, softer, damped in zip(LEVELS_V, SOFTER, DAMPED, strict=True):
        phases = np.exp(2j * np.pi * rng.random((lines.size, 2, realisations)))
        spectrum = np.where(played[:, None, None], phases, 0.0)
        spectrum *= level_v * samples / np.sqrt(2.0 * played.sum())
        gain = response(lines / samples / PERIOD_S, softer, damped)
        moved = np.fft.irfft(np.einsum("kij,kjr->kir", gain, spectrum), samples, axis=0)
        drive = np.fft.irfft(spectrum, samples, axis=0)
        noise = NOISE_UM * rng.normal(size=(*moved.shape, 2))
        levels.append((np.stack([drive, drive], axis=-1), moved[..., None] + noise))
    return levels


def recording(columns, name):
    """Return the recording of a table."""
    return axes_recordings_in(columns, name)[0]
