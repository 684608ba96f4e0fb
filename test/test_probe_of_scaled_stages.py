# SPDX-License-Identifier: BSD-3-Clause
"""Stages of unknown gain, speed, range and noise are identified as well as the default one."""

import dataclasses

import numpy as np
import pytest

from piezo_identification import identify, named_experiment, unseen_errors
from piezo_identification.experiments.catalogue import EXPERIMENTS, StageLimits
from piezo_identification.experiments.probing.probe import Probe
from piezo_identification.experiments.probing.probe_file import probe_document
from piezo_recorder.reading.recording import Recording
from piezo_recorder.sample_block import Flag
from piezo_sim.plant.plant_file import PlantConfig, read_plant
from piezo_sim.simulated_stage import SimulatedStage

RAMP_S = 0.14
LARGEST_CALL = 4_000_000
FACTORS = ("gain", "speed", "voltage", "noise")
LOUD = 1
"""Draw of the largest noise over the travel, which `docs/limits.md` names as too much."""


def scaled_effect(effect, gain, speed, voltage, noise):
    """An effect of the plant with all its parameters scaled by what they are measured in."""
    factors = {"um_per_v2": gain / voltage, "noise_rms_um": noise, "_um": gain * voltage,
               "rad_per_s": speed, "time_constant_s": 1.0 / speed, "_v": voltage,
               "_v_per_s": voltage}

    def scaled(name, value):
        for ending, factor in factors.items():
            if name.endswith(ending):
                return tuple(np.multiply(value, factor)) if isinstance(value, tuple) else (
                    value * factor)
        return value

    return type(effect)(**{field.name: scaled(field.name, getattr(effect, field.name))
                           for field in dataclasses.fields(effect)})


class ScaledStage:
    """Play experiments in lockstep, without ROS."""

    def __init__(self, gain=1.0, speed=1.0, voltage=1.0, noise=1.0):
        plant = read_plant()
        sections = [tuple(scaled_effect(effect, gain, speed, voltage, noise) for effect in section)
                    for section in (plant.amplifier, plant.stage, plant.sensor)]
        travel = gain * voltage
        self.limits = StageLimits(
            -20.0 * voltage, 120.0 * voltage, 2e6 * voltage, displacement_min_um=-45.0 * travel,
            displacement_max_um=145.0 * travel)
        self._stage = SimulatedStage(PlantConfig(*sections), seed=1)
        self._stage.open()
        self._sample = 0
        self.measured_um = []

    def play(self, experiment):
        """Return what is recorded, with the true displacement as a further column."""
        held = round(experiment.sample_period_s * self.limits.sample_rate_hz)
        waveform_v = np.tile(experiment.voltage_v, experiment.repeats)
        count = max(1, round(RAMP_S / experiment.sample_period_s))
        ramp, rest_v = np.arange(1, count + 1) / count, self.limits.rest_voltage_v
        voltage_v = np.concatenate([
            rest_v + ramp * (waveform_v[0] - rest_v), waveform_v,
            waveform_v[-1] + ramp * (rest_v - waveform_v[-1])])
        measured, true = [], []
        for values_v in np.array_split(voltage_v, 1 + voltage_v.size * held // LARGEST_CALL):
            samples_um = self._stage.exchange(np.repeat(values_v, held))
            self.measured_um += [samples_um.min(), samples_um.max()]
            for kept, each_um in ((measured, samples_um), (true, self._stage.true_displacement_um)):
                kept.append(each_um.reshape(-1, held).mean(axis=1))
        index = self._sample + held * np.arange(voltage_v.size)
        self._sample += held * voltage_v.size
        flags = np.repeat([Flag.RAMPING, Flag.PLAYING, Flag.RAMPING],
                          [count, waveform_v.size, count]).astype(np.uint32)
        return Recording(
            __file__, self.limits.sample_rate_hz, index,
            np.full(index.size, experiment.sample_period_s), voltage_v, np.concatenate(measured),
            flags, columns={"true_um": np.concatenate(true)})

    def probed(self):
        """Probe the stage; return the file's content."""
        probe = Probe(self.limits)
        while probe.step is not None:
            probe.take(self.play(probe.step))
        return probe_document(probe.findings, self.limits)

    def error_percent(self, document=None):
        """Identify, and measure the error of an unseen input against the true displacement."""
        recordings = {name: self.play(
            named_experiment(name, document.usable(self.limits), document.fitted(name))
            if document else named_experiment(name, self.limits)) for name in EXPERIMENTS}
        validation = recordings.pop("validation")
        truth = dataclasses.replace(validation, displacement_um=validation.columns["true_um"])
        return unseen_errors(identify(**recordings).model, truth)["e_y_percent"]


def drawn_factors(seed):
    exponents = np.random.default_rng(seed).uniform(-1.0, 1.0, len(FACTORS))
    return dict(zip(FACTORS, 5.0 ** exponents, strict=True))


@pytest.fixture(scope="module")
def default_error_percent():
    return ScaledStage().error_percent()


@pytest.mark.long
@pytest.mark.parametrize("factors", [
    {"gain": 0.2, "noise": 5.0, "speed": 0.2}, {"gain": 5.0, "noise": 0.2, "voltage": 0.2},
    {"speed": 5.0}, *(drawn_factors(seed) for seed in range(20) if seed != LOUD)])
def test_unknown_stage_is_identified_as_well_as_the_default_one(factors, default_error_percent):
    stage = ScaledStage(**factors)
    document = stage.probed()
    error_percent = stage.error_percent(document)
    # A tenth of the noise over the travel comes on top: averages take the rest.
    noise = factors.get("noise", 1.0) / (factors.get("gain", 1.0) * factors.get("voltage", 1.0))
    assert error_percent <= default_error_percent * (1.5 + 0.1 * noise)
    span_um = 190.0 * factors.get("gain", 1.0) * factors.get("voltage", 1.0)
    assert np.ptp(stage.measured_um) < span_um
