# SPDX-License-Identifier: BSD-3-Clause
"""The plant: the effects of a plant file, started and chained."""

from piezo_common.arrays import FloatArray
from piezo_sim.plant.linear_effects import LinearEffect, LinearRunner
from piezo_sim.plant.plant_effect import (
    Effect,
    PlantConfigError,
    Runner,
    StartedEffect,
    Surroundings,
)
from piezo_sim.plant.plant_file import PlantConfig


class Plant:
    """The simulated stage, sample by sample.

    It starts at rest: all relays off at the lowest voltage, then long at the rest voltage, so that
    creep and vibration have died out.

    Parameters
    ----------
    config : PlantConfig
        Effects of the plant.
    surroundings : Surroundings
        Sample period, rest voltage and seed.

    Raises
    ------
    PlantConfigError
        If the effects do not fit together.
    """

    def __init__(self, config: PlantConfig, surroundings: Surroundings) -> None:
        self._to_position = _start(config.amplifier, surroundings) + _start(
            config.stage, surroundings
        )
        self._to_measurement = _start(config.sensor, surroundings)
        if not any(isinstance(runner, LinearRunner) for runner in self._to_position):
            raise PlantConfigError(
                "stage: the displacement would jump with the voltage; add an effect with a lag."
            )
        level = surroundings.rest_voltage_v
        for runner in self._to_position + self._to_measurement:
            level = runner.rest(level)

    def respond(self, voltage_v: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Play voltages and return the displacement at their sample instants.

        Parameters
        ----------
        voltage_v : ndarray of float64, shape (N,)
            Commanded voltages; each acts from its sample instant to the next.

        Returns
        -------
        measured_um, true_um : ndarray, shape (N,)
            Measured and true displacement at the sample instants, before that voltage acts.
        """
        true_um = voltage_v.copy()
        for runner in self._to_position:
            runner.apply(true_um)
        measured_um = true_um.copy()
        for runner in self._to_measurement:
            runner.apply(measured_um)
        return measured_um, true_um


def _start(effects: tuple[Effect, ...], surroundings: Surroundings) -> list[Runner]:
    """Start effects; neighbouring linear effects become one exactly discretised series."""
    groups: list[StartedEffect | list[LinearEffect]] = []
    for effect in effects:
        if isinstance(effect, LinearEffect):
            neighbours = groups[-1] if groups else None
            if isinstance(neighbours, list):
                neighbours.append(effect)
            else:
                groups.append([effect])
        elif isinstance(effect, StartedEffect):
            groups.append(effect)
        else:
            raise PlantConfigError(f"{effect.name}: it has neither state_space nor start; "
                                   "give it the one or the other.")
    return [LinearRunner(group, surroundings.sample_period_s) if isinstance(group, list)
            else group.start(surroundings) for group in groups]
