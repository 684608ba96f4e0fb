# SPDX-License-Identifier: BSD-3-Clause
"""The whole stage: Preisach hysteresis, then creep, then electric and vibration dynamics.

Effects describe what these three do not explain, each at its place in the cascade.
"""

from dataclasses import dataclass, field, replace
from os import PathLike
from typing import TYPE_CHECKING, Any

import control
import numpy as np
from numpy.typing import ArrayLike

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_common.summary_table import SummaryTable
from piezo_models.effects.amplifier_lag import (
    SettledLag,
    advance_with_overshoot,
    as_rows_show,
    parts_of_rows,
    with_overshoot,
)
from piezo_models.effects.bouc_wen_hysteresis import BoucWenHysteresis
from piezo_models.effects.effect import Effect
from piezo_models.effects.hysteresis import Hysteresis
from piezo_models.hysteresis.first_rise import CYCLED, FirstRise
from piezo_models.hysteresis.hysteretic_creep import HystereticCreep, HystereticCreepMemory
from piezo_models.hysteresis.preisach import PreisachMemory, PreisachModel
from piezo_models.linear.connections import in_series, matrices_of
from piezo_models.linear.dynamics import (
    CreepDynamics,
    ElectricVibrationDynamics,
    answering_means,
    continue_linear,
    equilibrium_state,
    zoh,
)
from piezo_models.model_summary import summary_of_model, text_of_model

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(eq=False)
class StageMemory:
    """Memory of the stage: the past of its hysteresis and the state of `StageModel.linear`.

    It also holds the past of the hysteretic creep (None without one), the pasts of the effects by
    their index in the model (see `piezo_models.effects.effect.Effect.advance`), and the highest
    voltage so far, which a model with a first rise needs.
    """

    hysteresis: PreisachMemory
    linear_state: FloatArray
    hysteretic_creep: HystereticCreepMemory | None = None
    effects: dict[int, Any] = field(default_factory=dict)
    highest_v: float = CYCLED

    def copy(self) -> "StageMemory":
        """Return an independent memory with the same past."""
        hysteretic = None if self.hysteretic_creep is None else self.hysteretic_creep.copy()
        return StageMemory(
            self.hysteresis.copy(), self.linear_state.copy(), hysteretic, dict(self.effects),
            self.highest_v)


@dataclass(frozen=True, eq=False)
class StageModel:
    """Cascade of hysteresis, creep, and electric and vibration dynamics, Fig. 4.3."""

    hysteresis: PreisachModel
    creep: CreepDynamics
    dynamics: ElectricVibrationDynamics

    hysteretic_creep: HystereticCreep | None = None
    """Added to the output of the hysteresis. Simulations include it; inversions omit it, and the
    feedback corrects its slow motion."""
    effects: tuple[Effect, ...] = ()
    """Further effects; those at the same place act in this order."""
    first_rise: FirstRise | None = None
    """Displacement that a stage lacks until it has risen to its highest voltage once; without
    effect for a stage that was cycled, which is the default of a memory."""

    def __repr__(self) -> str:
        return text_of_model(self)

    def _repr_html_(self) -> str:
        return self.summary()._repr_html_()

    def summary(self) -> SummaryTable:
        """Return the parameters as a table, in rad/s and in Hz."""
        return summary_of_model(self)

    def plot(self) -> "Figure":
        """Draw Preisach plane, loops and frequency response; see `model_pictures.draw_model`."""
        from piezo_models.model_pictures import draw_model

        return draw_model(self)

    def to_control(self, sample_period_s: float | None = None, lags: bool = True,
                   ) -> control.StateSpace:
        """Return the linear part as a system; see `piezo_models.control_objects.to_control`."""
        from piezo_models.control_objects import to_control

        return to_control(self, sample_period_s, lags)

    def to_matlab(self, path: str | PathLike[str]) -> None:
        """Write the model for MATLAB; see `piezo_models.control_objects.write_matlab`."""
        from piezo_models.control_objects import write_matlab

        write_matlab(path, self)

    @property
    def has_hysteresis(self) -> bool:
        """Whether slow voltages give loops, by the density or by an effect."""
        return not self.hysteresis.is_line or any(
            isinstance(effect, BoucWenHysteresis | Hysteresis) for effect in self.effects)

    def effects_at(self, place: str) -> tuple[Any, ...]:
        """Return the effects at one of `piezo_models.effects.effect.PLACES`."""
        return tuple(effect for effect in self.effects if effect.place == place)

    def as_rows_show(self, sample_period_s: float) -> "StageModel":
        """Return the model with lags that settle within a row moved behind the hysteresis."""
        effects = as_rows_show(self.effects, sample_period_s)
        return self if effects == self.effects else replace(self, effects=effects)

    def linear(self) -> control.StateSpace:
        """Return the continuous state space from hysteresis output to displacement."""
        parts = [self.dynamics.state_space(self.effects_at("modes")), self.creep.state_space(),
                 *(effect.state_space() for effect in self.effects_at("linear"))]
        return control.ss(*in_series(map(matrices_of, parts)))

    def response(self, frequency_hz: ArrayLike) -> ComplexArray:
        """Return the complex response of `linear` at the given frequencies."""
        response = self.creep.response(frequency_hz) * self.dynamics.response(
            frequency_hz, self.effects_at("modes"))
        s = 2j * np.pi * np.asarray(frequency_hz, dtype=float)
        for effect in self.effects_at("linear"):
            response = response * effect.response(s)
        return response

    def small_signal_response(self, frequency_hz: ArrayLike) -> ComplexArray:
        """Return `response` with the linear effects on voltage, displacement and sensor."""
        response = self.response(frequency_hz)
        s = 2j * np.pi * np.asarray(frequency_hz, dtype=float)
        for effect in self.effects:
            if effect.place in ("voltage", "displacement", "sensor"):
                response = response * effect.response(s)
        return response

    def amplified(self, voltage_v: ArrayLike, sample_period_s: float,
                  memory: StageMemory | None = None) -> FloatArray:
        """Return the voltage behind the effects that act on it, shape (N,); update the memory."""
        applied_v: FloatArray = np.asarray(voltage_v, dtype=float)
        return self._behind(("voltage",), applied_v, sample_period_s, memory)

    def sensed(self, displacement_um: FloatArray, sample_period_s: float,
               memory: StageMemory | None = None) -> FloatArray:
        """Return what the sensor measures when `linear` puts out this displacement.

        The effects on displacement and sensor are applied; those in `memory` are continued.
        """
        return self._behind(("displacement", "sensor"), displacement_um, sample_period_s, memory)

    def _behind(self, places: tuple[str, ...], signal: FloatArray, sample_period_s: float,
                memory: StageMemory | None) -> FloatArray:
        pasts = {} if memory is None else memory.effects
        for place in places:
            for index, effect in enumerate(self.effects):
                if effect.place == place and len(signal):
                    signal, pasts[index] = advance_with_overshoot(
                        effect, signal, sample_period_s, pasts.get(index), self.effects)
        return signal

    def memory(self, rest_voltage_v: float = 0.0, hysteresis: PreisachMemory | None = None,
               settled: bool = True, highest_v: float = CYCLED) -> StageMemory:
        """Return the memory of a stage at rest.

        Parameters
        ----------
        rest_voltage_v : float
            Voltage in V, reached from negative saturation; not used if `hysteresis` is given.
        hysteresis : PreisachMemory, optional
            Past of the hysteresis, in place of `rest_voltage_v`; copied.
        settled : bool
            True: the stage has rested for so long that the creep is over, and the linear states
            are in equilibrium with the hysteresis output. False: they are zero.
        highest_v : float
            Highest voltage so far, for a model with a first rise; by default it was cycled.
        """
        if hysteresis is None:
            hysteresis = self.hysteresis.memory()
            self.hysteresis.simulate([rest_voltage_v], hysteresis)
        else:
            hysteresis = hysteresis.copy()
        hysteretic = None
        if self.hysteretic_creep is not None:
            extremes_v = hysteresis.extremes_v[: hysteresis.top + 1]
            hysteretic = self.hysteretic_creep.memory(extremes_v, settled)
        memory = StageMemory(hysteresis, np.empty(0), hysteretic, highest_v=highest_v)
        memory.linear_state = equilibrium_state(
            self.linear(), self._held_um(memory) if settled else 0.0)
        return memory

    def _held_um(self, memory: StageMemory) -> float:
        """Return the last input of the linear part in um."""
        held_um = memory.hysteresis.hysteresis_um
        if self.hysteretic_creep is not None and memory.hysteretic_creep is not None:
            held_um += self.hysteretic_creep.held_um(memory.hysteretic_creep)
        if self.first_rise is not None:
            held_um += self.first_rise.simulate(
                [memory.hysteresis.voltage_v], memory.highest_v)[0]
        return float(held_um)

    def simulate(self, voltage_v: ArrayLike, sample_period_s: float,
                 memory: StageMemory | None = None) -> FloatArray:
        """Return the displacement (um) at the sample instants, (N,), each before its voltage acts.

        Parameters
        ----------
        voltage_v : (N,) array_like
            Voltages in V, each held for a sample period.
        memory : StageMemory, optional
            Past of the stage; continued, and updated in place. By default the stage has rested at
            0 V, reached from negative saturation, until the creep was over; nonlinear effects have
            rested at their first input. Parts that are simulated one after the other, with one
            memory and one sample period, give the same result as the whole.

        Raises
        ------
        ValueError
            If a voltage is not finite, the sample period is not positive, or the memory is one of
            a model without hysteretic creep.
        """
        memory = self.memory() if memory is None else memory
        acting = self.as_rows_show(sample_period_s)
        parts = parts_of_rows(acting.effects_at("voltage"), sample_period_s)
        part_s = sample_period_s / parts
        linear, state = self.linear(), memory.linear_state
        for effect in reversed(acting.effects):
            if isinstance(effect, SettledLag):
                lag = effect.state_space()
                linear = linear * lag
                state = np.append(equilibrium_state(lag, self._held_um(memory)), state)
        if parts > 1:
            linear = answering_means(linear, part_s)
        system = zoh(linear, part_s)
        applied_v = acting.amplified(
            np.repeat(np.asarray(voltage_v, dtype=float), parts), part_s, memory)
        extremes_v, count = with_overshoot(
            applied_v, memory.hysteresis.voltage_v, acting.effects)
        hysteresis = self.hysteresis.simulate(extremes_v, memory.hysteresis)[count - 1 :: count]
        hysteresis += self.hysteresis.line_beyond_um(applied_v)
        if self.hysteretic_creep is not None:
            if memory.hysteretic_creep is None:
                raise ValueError("the memory has no part for the hysteretic creep; "
                                 "take one from this model's memory()")
            hysteresis += self.hysteretic_creep.simulate(
                applied_v, part_s, memory.hysteretic_creep
            )
        if self.first_rise is not None and applied_v.size:
            hysteresis += self.first_rise.simulate(applied_v, memory.highest_v)
            memory.highest_v = max(memory.highest_v, float(applied_v.max()))
        displacement, state = continue_linear(system, hysteresis, state)
        memory.linear_state = state[state.size - memory.linear_state.size :]
        return self.sensed(displacement[::parts], sample_period_s, memory)
