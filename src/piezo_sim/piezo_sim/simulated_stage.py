# SPDX-License-Identifier: BSD-3-Clause
"""The simulated stage as a backend of the stage node."""

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piezo_common.arrays import FloatArray
from piezo_common.gsf import Field
from piezo_sim.plant.plant import AxesPlant, Plant
from piezo_sim.plant.plant_effect import Surroundings
from piezo_sim.plant.plant_file import AxesPlantConfig, PlantConfig, read_any_plant
from piezo_sim.specimen.specimen import Specimen
from piezo_stage_driver.backends.backend import BackendFault

SEEDS_APART = 2**31
"""Difference between the seeds of two axes; the seed of a stage is below it."""


class SimulatedStage:
    """A simulated stage that plays voltages and measures displacements, of one axis or several.

    Every `open` starts from the same rest: long at the rest voltage, reached from the lowest one.
    The same seed and voltages give bitwise equal displacements, for any division of the voltages
    into calls.

    Parameters
    ----------
    plant : path-like, PlantConfig or AxesPlantConfig, optional
        Plant file, name of a plant of this package (`named_plants`), or a plant that was read; by
        default the stage of thesis chapter 4.
    seed : int
        Seed of all random numbers, not negative.
    rest_voltage_v : float or sequence of float
        Voltage in V at which the stage has rested; for all axes, or for each.
    specimen : Field, optional
        Heights under the tip, which the first two axes move; see `Specimen`.

    Attributes
    ----------
    axes : tuple of str
        Names of several axes; empty for one.
    true_displacement_um : ndarray, shape (N,) or (N, axes)
        Displacement in um without the sensor at the instants of the last exchange.
    signals : tuple of str
        Names of the detectors; empty without a specimen.
    marks : ndarray of uint8
        Digital outputs at the samples of the last exchange; empty if none had a mark.
    on_truth : callable
        Called with it after each exchange; does nothing by default.

    Raises
    ------
    PlantConfigError
        If the plant file is invalid.
    ValueError
        If seed or sample rate is invalid.
    """

    name = "simulated"

    def __init__(self, plant: str | Path | PlantConfig | AxesPlantConfig | None = None,
                 seed: int = 0, sample_rate_hz: float = 40000.0,
                 rest_voltage_v: ArrayLike = 0.0, specimen: Field | None = None) -> None:
        if seed < 0:
            raise ValueError(f"seed is {seed}; give an integer that is not negative.")
        if not 0.0 < sample_rate_hz < float("inf"):
            raise ValueError(f"sample_rate_hz is {sample_rate_hz}; give a positive number.")
        self.sample_rate_hz = sample_rate_hz
        self.true_displacement_um = np.empty(0)
        self.on_truth: Callable[[FloatArray], object] = lambda displacement_um: None
        config = (plant if isinstance(plant, PlantConfig | AxesPlantConfig)
                  else read_any_plant(plant))
        self.axes = tuple(config.axes) if isinstance(config, AxesPlantConfig) else ()
        self._shape = (len(self.axes),) if self.axes else ()
        if specimen is not None and not self.axes:
            raise ValueError("the plant has one axis: a specimen lies under two.")
        self._under_tip = None if specimen is None else (lambda: Specimen(specimen, seed))
        self._specimen: Specimen | None = None
        self.signals = () if specimen is None else Specimen.signals
        self.marks = self._next_marks = np.empty(0, np.uint8)
        rests_v = np.broadcast_to(np.asarray(rest_voltage_v, dtype=float), self._shape or (1,))
        surroundings = [Surroundings(1.0 / sample_rate_hz, float(rest_v), seed + SEEDS_APART * axis)
                        for axis, rest_v in enumerate(rests_v)]
        self._start: Callable[[], Plant | AxesPlant] = lambda: (
            AxesPlant(config, surroundings) if isinstance(config, AxesPlantConfig)
            else Plant(config, surroundings[0]))
        self._plant: Plant | AxesPlant | None = None
        self._failed = False
        # Compiles what is not compiled yet, so that no exchange is delayed.
        self._start().respond(np.zeros((1, *self._shape)))

    def open(self) -> None:
        """Set the stage to rest, and start the noise from the seed."""
        self._failed = False
        self._plant = self._start()
        self._specimen = self._under_tip and self._under_tip()
        self.true_displacement_um = np.empty(0)

    def put_out_marks(self, marks: NDArray[np.uint8]) -> None:
        """Put out marks with the samples of the next exchange, shape (N,)."""
        self._next_marks = marks

    def read_signals(self) -> FloatArray:
        """Return what the detectors measured in the last exchange, shape (N, signals)."""
        assert self._specimen is not None  # otherwise there are no signals
        return self._specimen.measured(self.true_displacement_um[:, :2])

    def exchange(self, voltage_v: FloatArray) -> FloatArray:
        """Play voltages and return the displacements measured at their start.

        Parameters
        ----------
        voltage_v : array_like, shape (N,) or (N, axes)
            Commanded voltages; outside the amplifier's range they are clipped.

        Returns
        -------
        displacement_um : ndarray, shape (N,) or (N, axes)
            displacement_um[n] is measured at instant n, before voltage_v[n] acts.

        Raises
        ------
        ValueError
            If a voltage is not finite, or the array has not a column for each axis.
        RuntimeError
            If the stage is not open, or has failed.
        BackendFault
            If a fault in the plant file occurs. Like a real one, the amplifier then goes to rest by
            itself, and plays nothing before the next `open`.
        """
        if self._failed:
            raise RuntimeError("the simulated stage has failed; call nothing but close().")
        if self._plant is None:
            raise RuntimeError("the simulated stage is not open; call open() first.")
        voltage_v = np.ascontiguousarray(voltage_v, dtype=np.float64)
        if voltage_v.shape[1:] != self._shape or not voltage_v.ndim:
            wanted = f"a column for {' and '.join(self.axes)}" if self.axes else "one dimension"
            raise ValueError(f"voltage_v has the shape {voltage_v.shape}; give {wanted}.")
        # The sum of squares is faster than a check of each value, which follows if it is not
        # finite.
        flat_v = voltage_v.ravel()
        if not (math.isfinite(flat_v @ flat_v) or np.isfinite(flat_v).all()):
            first = np.argwhere(~np.isfinite(voltage_v))[0].tolist()
            raise ValueError(
                f"voltage_v{first} is {voltage_v[tuple(first)]}; give finite voltages.")
        try:
            displacement_um, self.true_displacement_um = self._plant.respond(voltage_v)
        except BackendFault:
            self._failed = True
            raise
        self.marks, self._next_marks = self._next_marks, np.empty(0, np.uint8)
        self.on_truth(self.true_displacement_um)
        return displacement_um

    def close(self) -> None:
        """Discard the state of the stage."""
        self._plant = None
