# SPDX-License-Identifier: BSD-3-Clause
"""The simulated XY stage: recordings of its experiments, and paths that it plays."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from piezo_client.scans import Scanned
from piezo_common.arrays import FloatArray
from piezo_common.gsf import Field
from piezo_controller.axes.stored_scan import StoredScan
from piezo_identification.axes.identify_axes import identify_several_axes
from piezo_identification.experiments.catalogue import Experiment
from piezo_identification.experiments.several_axes import axes_experiments
from piezo_identification.experiments.stage_limits import StageLimits
from piezo_models.axes.identified_axes import IdentifiedAxes
from piezo_recorder.reading.axes import AxesRecording
from piezo_recorder.reading.detected import SIGNAL, mark_columns
from piezo_sim.plant.plant_file import AxesPlantConfig, read_any_plant
from piezo_sim.simulated_stage import SimulatedStage

PLANT, CLOCK_HZ = "xy", 40_000.0
LIMITS = {"x": StageLimits(), "y": StageLimits(slew_limit_v_per_s=1.5e6)}
"""As in the parameter file of the simulated stage of two axes."""

VOLTAGE_RANGE_V = [(each.voltage_min_v, each.voltage_max_v) for each in LIMITS.values()]

NOISE_UM = np.array([0.002, 0.003])
"""RMS noise of the plant's sensors, in um."""

APPROACH_S, SETTLING_S = 0.1, 0.2
"""Ramp from rest to the first voltage, and what a path waits there."""

SAMPLES_AT_ONCE = 400_000
"""Clock samples that are simulated together."""

SEED = 21
"""Seed of the noise while a path is followed."""

LINEAR = ("electric_lag",)
"""Effects of an actuator without hysteresis and creep, as if it was driven by charge."""


def recorded(name: str, seed: int, plant: AxesPlantConfig | None = None) -> list[AxesRecording]:
    """Record the experiments of one name on a plant, each with the stage fresh from rest.

    The seed is that of the sensors' noise in the first recording; each further one has the next
    seed.
    """
    return [_recorded(experiment, seed + number, plant or plant_of_study())
            for number, experiment in enumerate(axes_experiments(name, LIMITS))]


def _recorded(experiment: Experiment, seed: int, plant: AxesPlantConfig) -> AxesRecording:
    """Record an experiment; the displacement is the mean over the time of each voltage."""
    held = round(experiment.sample_period_s * CLOCK_HZ)
    stage = SimulatedStage(plant, seed)
    stage.open()
    stage.exchange(ramp_of_study(experiment.voltage_v[0]))
    played_v = np.tile(experiment.voltage_v, (experiment.repeats, 1))
    block = max(1, SAMPLES_AT_ONCE // held)
    displacement_um = np.concatenate([
        stage.exchange(np.repeat(played_v[first:first + block], held, axis=0)).reshape(
            -1, held, len(LIMITS)).mean(axis=1)
        for first in range(0, len(played_v), block)])
    kept = experiment.settling_repeats * len(experiment.voltage_v)
    return AxesRecording(
        experiment.name, tuple(LIMITS), experiment.sample_period_s, played_v[kept:],
        displacement_um[kept:], experiment.repeats - experiment.settling_repeats if kept else 0)


def plant_of_study() -> AxesPlantConfig:
    """Return the plant of the study."""
    config = read_any_plant(PLANT)
    assert isinstance(config, AxesPlantConfig)
    return config


def linear_plant() -> AxesPlantConfig:
    """Return the plant of the study without hysteresis and creep; its actuators move 1 um/V."""
    plant = plant_of_study()
    return replace(plant, axes={axis: replace(own, stage=tuple(
        each for each in own.stage if each.name in LINEAR)) for axis, own in plant.axes.items()})


def ramp_of_study(voltage_v: FloatArray) -> FloatArray:
    """Return the way from rest at 0 V, (N, axes)."""
    return np.linspace(0.0, 1.0, round(APPROACH_S * CLOCK_HZ))[:, None] * voltage_v


def identified() -> IdentifiedAxes:
    """Identify the stage from steps and loops of each axis, and multisines of both."""
    return identify_several_axes(
        recorded("multisine", 5), recorded("validation", 9), creep=recorded("creep", 1),
        hysteresis=recorded("hysteresis", 3))


def followed(scan: StoredScan, periods: int, mean_of: int = 1) -> Scanned:
    """Play a path on the stage, fresh from rest, and return how it was followed.

    After `periods`, the mean of `mean_of` periods counts, which has less noise.
    """
    stage = moving(scan, periods, SimulatedStage(plant_of_study(), SEED))
    displacement_um = np.mean([stage.exchange(scan.voltage_v) for _ in range(mean_of)], axis=0)
    return Scanned(Path(PLANT), scan, displacement_um)


def imaged(scan: StoredScan, specimen: Field,
           plant: AxesPlantConfig | None = None) -> AxesRecording:
    """Play two periods of a scan over a specimen; return the recording of the second."""
    stage = moving(scan, 1, SimulatedStage(plant or plant_of_study(), SEED, specimen=specimen))
    displacement_um = stage.exchange(scan.voltage_v)
    signals = dict(zip(stage.signals, stage.read_signals().T, strict=True))
    return AxesRecording(
        PLANT, scan.axes, scan.sample_period_s, scan.voltage_v, displacement_um, columns={
            **{name + SIGNAL: column for name, column in signals.items()},
            **mark_columns(scan.marks)})


def moving(scan: StoredScan, periods: int, stage: SimulatedStage) -> SimulatedStage:
    """Return the stage after some periods of a scan."""
    stage.open()
    stage.exchange(ramp_of_study(scan.begin_voltage_v[0]))
    stage.exchange(np.tile(scan.begin_voltage_v[0], (round(SETTLING_S * CLOCK_HZ), 1)))
    stage.exchange(scan.repeated_v(periods))
    return stage
