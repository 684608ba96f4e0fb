# SPDX-License-Identifier: BSD-3-Clause
"""The plant: the effects of a plant file, started and chained."""

from collections.abc import Sequence

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_sim.plant.linear_effects import LinearEffect, LinearRunner
from piezo_sim.plant.mechanism import MechanismRunner
from piezo_sim.plant.plant_effect import (
    Effect,
    PlantConfigError,
    Runner,
    StartedEffect,
    Surroundings,
)
from piezo_sim.plant.plant_file import AxesPlantConfig, PlantConfig


class Plant:
    """The simulated stage, sample by sample.

    It starts at rest: all relays off at the lowest voltage, then long at the rest voltage, so that
    creep and vibration are over.

    Parameters
    ----------
    surroundings : Surroundings
        Sample period, rest voltage and seed.

    Raises
    ------
    PlantConfigError
        If the effects do not fit together.
    """

    def __init__(self, config: PlantConfig, surroundings: Surroundings) -> None:
        self._to_position = start(config.amplifier, surroundings) + start(
            config.stage, surroundings
        )
        self._to_measurement = start(config.sensor, surroundings)
        if not any(isinstance(runner, LinearRunner) for runner in self._to_position):
            raise PlantConfigError(
                "stage: the displacement would jump with the voltage; add an effect with a lag."
            )
        rest(self._to_position + self._to_measurement, surroundings.rest_voltage_v)

    def respond(self, voltage_v: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Play voltages and return the displacements at their sample instants.

        Parameters
        ----------
        voltage_v : ndarray of float64, shape (N,)
            Commanded voltages; each acts from its sample instant to the next.

        Returns
        -------
        measured_um, true_um : ndarray, shape (N,)
            Measured and true displacement at the sample instants, before that voltage acts.
        """
        true_um = passed(self._to_position, voltage_v)
        return passed(self._to_measurement, true_um), true_um


class AxesPlant:
    """The simulated stage of several axes: a chain of effects for each, and common mechanics.

    It starts at rest like a `Plant`.
    """

    def __init__(self, config: AxesPlantConfig, surroundings: Sequence[Surroundings]) -> None:
        axes = list(zip(config.axes.values(), surroundings, strict=True))
        self._to_strokes = [start(axis.amplifier, of_axis) + start(axis.stage, of_axis)
                            for axis, of_axis in axes]
        self._to_measurement = [start(axis.sensor, of_axis) for axis, of_axis in axes]
        self._mechanism = MechanismRunner(config.mechanics.mechanism(),
                                          surroundings[0].sample_period_s)
        readings_um = self._mechanism.rest(np.array(
            [rest(runners, of_axis.rest_voltage_v)
             for runners, of_axis in zip(self._to_strokes, surroundings, strict=True)]))
        for runners, reading_um in zip(self._to_measurement, readings_um, strict=True):
            rest(runners, reading_um)

    def respond(self, voltage_v: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Play voltages of all axes, shape (N, axes); see `Plant.respond`."""
        true_um, seen_um = self._mechanism.respond(_passed_each(self._to_strokes, voltage_v))
        return _passed_each(self._to_measurement, seen_um), true_um


def rest(runners: Sequence[Runner], level: float) -> float:
    """Settle effects one after the other at a constant input; return the output."""
    for runner in runners:
        level = runner.rest(level)
    return level


def passed(runners: Sequence[Runner], samples: FloatArray) -> FloatArray:
    """Return the samples, shape (N,), after a series of effects."""
    samples = samples.copy()
    for runner in runners:
        runner.apply(samples)
    return samples


def _passed_each(chains: Sequence[Sequence[Runner]], samples: FloatArray) -> FloatArray:
    """Return the samples of each axis, shape (N, axes), after its own effects."""
    return np.column_stack([passed(runners, column)
                            for runners, column in zip(chains, samples.T, strict=True)])


def start(effects: tuple[Effect, ...], surroundings: Surroundings) -> list[Runner]:
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
