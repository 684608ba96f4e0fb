# SPDX-License-Identifier: BSD-3-Clause
"""Mechanics of several axes: masses and springs that actuators push together.

The coordinates q follow M q'' + D q' + K q = P u with the free strokes u of the actuators, held
between samples. In the modes of M and K, which the damping D does not couple, every mode has its
own exact discrete step.
"""

from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from numba import njit
from scipy.linalg import eigh, expm

from piezo_common.arrays import FloatArray
from piezo_sim.plant.plant_effect import Effect


class Mechanism(NamedTuple):
    """Matrices of n coordinates and m axes."""

    mass: FloatArray
    stiffness: FloatArray
    """Symmetric and positive definite mass and stiffness matrices, (n, n)."""
    push: FloatArray
    """Force on each coordinate per stroke, (n, m)."""
    position: FloatArray
    reading: FloatArray
    """Matrices from the coordinates to the position of each axis, and to its sensor's reading, (m,
    n)."""
    damping_ratios: FloatArray
    """Damping ratios of the modes, the lowest mode first, (n,)."""


@runtime_checkable
class Mechanics(Effect, Protocol):
    """An effect that moves all axes of a plant."""

    @property
    def axes(self) -> int:
        """Return the number of axes."""

    def mechanism(self) -> Mechanism:
        """Return the matrices."""


@njit(cache=True)
def _advance(strokes: FloatArray, state: FloatArray, steps: FloatArray, drives: FloatArray,
             push: FloatArray, outputs: FloatArray, found: FloatArray) -> None:
    for n in range(len(strokes)):
        for row in range(len(outputs)):
            total = 0.0
            for mode in range(len(state)):
                total += outputs[row, mode] * state[mode, 0]
            found[n, row] = total
        for mode in range(len(state)):
            force = 0.0
            for axis in range(strokes.shape[1]):
                force += push[mode, axis] * strokes[n, axis]
            place, speed = state[mode]
            step = steps[mode]
            state[mode, 0] = step[0, 0] * place + step[0, 1] * speed + drives[mode, 0] * force
            state[mode, 1] = step[1, 0] * place + step[1, 1] * speed + drives[mode, 1] * force


class MechanismRunner:
    """A mechanism with the state of its modes."""

    def __init__(self, mechanism: Mechanism, sample_period_s: float) -> None:
        squares, shapes = eigh(mechanism.stiffness, mechanism.mass)
        # Force over the squared frequency, so that a mode at rest equals it.
        self._push = (shapes.T @ mechanism.push) / squares[:, None]
        self._outputs = np.vstack([mechanism.position, mechanism.reading]) @ shapes
        blocks = [expm(sample_period_s * np.array([
            [0.0, w, 0.0], [-w, -2.0 * damping * w, w], [0.0, 0.0, 0.0]]))
            for w, damping in zip(np.sqrt(squares), mechanism.damping_ratios, strict=True)]
        self._steps = np.array([block[:2, :2] for block in blocks])
        self._drives = np.array([block[:2, 2] for block in blocks])
        self._state = np.zeros((len(squares), 2))

    def rest(self, strokes_um: FloatArray) -> FloatArray:
        """Settle at constant strokes, shape (m,); return the readings, shape (m,)."""
        self._state[:, 0], self._state[:, 1] = self._push @ strokes_um, 0.0
        readings_um: FloatArray = (self._outputs @ self._state[:, 0])[len(strokes_um):]
        return readings_um

    def respond(self, strokes_um: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return positions and readings (um) before each stroke acts, all of shape (N, m)."""
        found = np.empty((len(strokes_um), len(self._outputs)))
        _advance(strokes_um, self._state, self._steps, self._drives, self._push, self._outputs,
                 found)
        axes = strokes_um.shape[1]
        return found[:, :axes], found[:, axes:]
