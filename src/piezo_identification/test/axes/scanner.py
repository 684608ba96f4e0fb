# SPDX-License-Identifier: BSD-3-Clause
"""The flexure with hysteresis and creep of each axis in front of its modes, for tests.

Plays step by step, creep as leaky sums, modes one by one: nothing of it is shared with the models.
"""

import flexure
import numpy as np
from scipy.signal import lfilter

RANGE_V = 100.0
PLAYS_V = np.array([[1.0, 2.5, 5.0, 9.0, 15.0], [0.7, 2.0, 4.0, 10.0, 18.0]])
WEIGHTS = np.array([[0.06, 0.05, 0.05, 0.04, 0.03], [0.05, 0.06, 0.04, 0.05, 0.02]])
BENT_PER_V = 1e-3
"""Of the curve that each play passes."""
CREEP_S = np.array([[0.2, 4.0], [0.15, 6.0]])
CREEP = np.array([[0.008, 0.012], [0.010, 0.015]])


def passed_v(voltage_v, axis):
    """Return what the plays of an axis pass on that was cycled before its lowest voltage."""
    changed = np.flatnonzero(np.diff(voltage_v, prepend=np.nan))
    passed = np.zeros(changed.size)
    for play_v, weight in zip(PLAYS_V[axis].tolist(), WEIGHTS[axis].tolist(), strict=True):
        moved, way = float(voltage_v[0]) + play_v, []
        for now in voltage_v[changed].tolist():
            moved = min(max(moved, now - play_v), now + play_v)
            way.append(moved)
        passed += weight * np.multiply(way, 1.0 + BENT_PER_V * np.array(way))
    held = np.repeat(passed, np.diff(changed, append=voltage_v.size))
    return (1.0 - WEIGHTS[axis].sum()) * voltage_v + held


def drive_v(voltage_v, axis):
    """Return what moves the modes: what the plays pass on, and the creep behind it."""
    passed = passed_v(voltage_v, axis)
    drive = passed.copy()
    for lasting_s, part in zip(CREEP_S[axis], CREEP[axis], strict=True):
        kept = np.exp(-flexure.PERIOD_S / lasting_s)
        drive += part * lfilter([0.0, 1.0 - kept], [1.0, -kept], passed - passed[0])
    return drive


def motion_um(voltage_v):
    """Return the samples of both sensors, without noise."""
    drive = np.column_stack([drive_v(voltage_v[:, axis], axis) for axis in range(2)])
    drive -= drive[0]
    a, b, c = flexure.continuous()
    rates, shapes = np.linalg.eig(a)
    pushed = np.linalg.solve(shapes, b)
    steps = np.exp(rates * flexure.PERIOD_S)
    states = np.stack([lfilter([0.0, (step - 1.0) / rate], [1.0, -step], drive @ push)
                       for step, rate, push in zip(steps, rates, pushed, strict=True)], axis=1)
    found = np.zeros((len(voltage_v), 2))
    for sensor, late in enumerate(flexure.LATE):
        whole = int(late) + 1
        on = np.exp(rates * (whole - late) * flexure.PERIOD_S)
        seen = states @ (c[sensor] @ shapes * on) + drive @ (
            pushed.T @ (c[sensor] @ shapes * (on - 1.0) / rates))
        found[whole:, sensor] = seen.real[:-whole]
    return found


def table(voltage_v, rng, every=1):
    """Return the columns of a measured table of which every so many-th row is kept."""
    measured = motion_um(voltage_v) + flexure.NOISE_UM * rng.normal(size=voltage_v.shape)
    columns = {"time_s": flexure.PERIOD_S * np.arange(len(voltage_v)),
               "x_voltage_v": voltage_v[:, 0], "y_voltage_v": voltage_v[:, 1],
               "x_displacement_um": measured[:, 0], "y_displacement_um": measured[:, 1]}
    return {name: values[::every] for name, values in columns.items()}


def along(axis, voltage_v):
    """Return voltages of both axes of which one moves."""
    return voltage_v[:, None] * np.eye(2)[axis]


def loops_v(samples, turns=7):
    """Return a triangle whose peaks fall from the range, and whose valleys rise to its middle."""
    tops = RANGE_V * (1.0 - 0.5 * np.arange(turns + 1) / turns)
    valleys = RANGE_V * 0.5 * np.arange(turns + 1) / turns
    corners = np.column_stack([tops, valleys]).ravel()
    corners = np.concatenate([[0.0, RANGE_V, 0.0], corners, [0.0]])
    place = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(corners)))])
    return np.interp(np.linspace(0.0, place[-1], samples), place, corners)


def steps_v(samples, held):
    """Return a voltage that is held between steps."""
    levels = np.array([0.0, 80.0, 30.0, 60.0])
    return levels[np.minimum(np.arange(samples) // held, levels.size - 1)]


def experiments(rng, samples=4096, loop_samples=20_000, step_samples=120_000):
    """Return tables by experiment: steps and loops of each axis, multisines of each and of both.

    Rows of slow ones are thinned.
    """
    fast = np.column_stack([flexure.multisine_v(samples, rng) for _ in range(4)])
    return {
        "creep": [table(along(axis, steps_v(step_samples, step_samples // 4)), rng, 100)
                  for axis in range(2)],
        "hysteresis": [table(along(axis, loops_v(loop_samples)), rng, 8) for axis in range(2)],
        "dynamics": [table(50.0 + each, rng) for each in (
            along(0, fast[:, 0]), along(1, fast[:, 1]), fast[:, 2:])]}
