# SPDX-License-Identifier: BSD-3-Clause
"""A stage that is simulated row by row: amplifier, hysteresis, linear dynamics, delay."""

from dataclasses import dataclass, field

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_studies.other_makes.hystereses import Hysteresis
from piezo_studies.other_makes.linear_system import (
    LinearSystem,
    held_response,
    knots_s,
    straight_response,
    unchanged,
)


@dataclass(frozen=True)
class HeldVoltage:
    """A voltage that is held for a period in each row."""

    voltage_v: FloatArray
    """Shape (N,)."""
    period_s: float


@dataclass(frozen=True)
class Stage:
    """The cascade of a stage, which is independent of the models."""

    hysteresis: Hysteresis

    behind: LinearSystem
    """Creep, modes and lags after the hysteresis."""
    front: LinearSystem = field(default_factory=unchanged)
    """The amplifier, before the hysteresis."""
    delay_s: float = 0.0
    """Delay of the reading."""

    def displacement_um(self, past: list[HeldVoltage], played: HeldVoltage) -> FloatArray:
        """Return the displacement at the times at which the voltages of rows change.

        Parameters
        ----------
        past : list of HeldVoltage
            Voltages played before, on a stage that was never cycled and begins at rest at 0 V.

        Returns
        -------
        ndarray, shape (N,)
        """
        late_rows = int(np.ceil(self.delay_s / played.period_s - 1e-9))
        read_s = max(late_rows * played.period_s - self.delay_s, 0.0)
        begun = HeldVoltage(np.append(np.full(late_rows, played.voltage_v[0]), played.voltage_v),
                       played.period_s)
        fastest_per_s = np.abs(self.front.poles_per_s).max(initial=0.0)
        pieces, knots, state = [], [], np.zeros(self.front.poles_per_s.size, complex)
        for each in (*past, begun):
            knots.append(knots_s(each.period_s, fastest_per_s,
                                 read_s if each is begun else 0.0))
            reached_v, state = held_response(self.front, each.voltage_v, knots[-1], state)
            pieces.append(reached_v)
        driven_um = self.hysteresis(np.concatenate([piece.ravel() for piece in pieces]))
        state, first = np.zeros(self.behind.poles_per_s.size, complex), 0
        for piece, instants in zip(pieces, knots, strict=True):
            part_um = driven_um[first : first + piece.size].reshape(piece.shape)
            first += piece.size
            read = int(np.argmin(np.abs(instants - read_s))) if piece is pieces[-1] else 0
            answer_um, state = straight_response(self.behind, part_um, instants, read, state)
        return answer_um[: played.voltage_v.size]
