# SPDX-License-Identifier: BSD-3-Clause
"""A probe of stages of another form: filters of SciPy, with noise and a bounded sensor."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

from piezo_identification.experiments.catalogue import EXPERIMENTS, named_experiment
from piezo_identification.experiments.probing import probe_file
from piezo_identification.experiments.probing.probe import SIGNAL_TO_NOISE, Probe
from piezo_identification.experiments.probing.step_response import step_response
from piezo_identification.experiments.stage_limits import StageLimits
from piezo_recorder.reading.recording import Recording
from piezo_recorder.sample_block import Flag

LIMITS = StageLimits(-20.0, 120.0, 2e5, 4000.0, displacement_min_um=-60.0,
                     displacement_max_um=150.0)
"""A slow clock keeps the long holds cheap."""


class FilterStage:
    """A vibration and relaxations side by side, played sample by sample."""

    def __init__(self, gain=0.8, frequency_hz=150.0, damping=0.05, creep=((0.04, 2.0),),
                 noise_um=0.01, limits=LIMITS, resolution_um=0.0):
        self.limits, self.noise_um, self.resolution_um = limits, noise_um, resolution_um
        self.played, self.highest_um, self.lowest_um = [], -np.inf, np.inf
        self._random, self._sample = np.random.default_rng(5), 0
        omega = 2.0 * np.pi * frequency_hz
        parts = [([omega**2], [1.0, 2.0 * damping * omega, omega**2])]
        parts += [([share], [time_s, 1.0]) for share, time_s in creep]
        self._filters = []
        for numerator, denominator in parts:
            b, a, _ = cont2discrete((numerator, denominator), 1.0 / limits.sample_rate_hz)
            self._filters.append([gain * b.ravel(), a, np.zeros(len(a) - 1)])

    def play(self, experiment):
        """Play a step, and return what was recorded."""
        self.played.append(experiment)
        held = round(experiment.sample_period_s * self.limits.sample_rate_hz)
        voltage_v = np.repeat(experiment.voltage_v, held)
        displacement_um = np.zeros(voltage_v.size)
        for part in self._filters:
            answer_um, part[2] = lfilter(part[0], part[1], voltage_v, zi=part[2])
            displacement_um += answer_um
        self.highest_um = max(self.highest_um, displacement_um.max())
        self.lowest_um = min(self.lowest_um, displacement_um.min())
        displacement_um += self.noise_um * self._random.normal(size=voltage_v.size)
        if self.resolution_um:
            displacement_um = self.resolution_um * np.round(displacement_um / self.resolution_um)
        index = self._sample + held * np.arange(experiment.voltage_v.size)
        self._sample += voltage_v.size
        return Recording(
            experiment.name, self.limits.sample_rate_hz, index,
            np.full(index.size, experiment.sample_period_s), experiment.voltage_v,
            displacement_um.reshape(-1, held).mean(axis=1),
            np.full(index.size, Flag.PLAYING, dtype=np.uint32))

    def probed(self):
        """Probe the stage to the end."""
        probe = Probe(self.limits)
        while probe.step is not None:
            probe.take(self.play(probe.step))
        return probe.findings

    def sizes_v(self):
        """Largest voltage of each step."""
        return [np.abs(step.voltage_v).max() for step in self.played if np.any(step.voltage_v)]


@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_step_response_of_a_lag_and_two_modes_is_taken_apart(noise):
    time_s = np.arange(4000) / 40_000.0
    poles = np.array([-300.0 + 3000.0j, -200.0 + 9000.0j])
    response = 1.0 - 0.7 * np.exp(-time_s / 0.002) - 0.2 * (
        np.exp(poles[0] * time_s)).real - 0.1 * np.exp(poles[1] * time_s).real
    response += noise * np.random.default_rng(2).normal(size=time_s.size)
    found = step_response(response, max(noise, 1e-9), 1.0 / 40_000.0)
    assert found.lag_s == pytest.approx(0.002, rel=0.02)
    assert [frequency for frequency, _, _ in found.modes] == pytest.approx(
        np.abs(poles) / (2.0 * np.pi), rel=0.01)
    assert [damping for _, damping, _ in found.modes] == pytest.approx(
        -poles.real / np.abs(poles), rel=0.05)
    assert found.settling_s == pytest.approx(np.log(10.0) / 200.0, rel=0.05)
    # The gain from the poles against that of the transfer function.
    omega = 2.0 * np.pi * 477.0
    exact = 1.0 - 0.7 * 1j * omega / (1j * omega + 500.0) - 0.5 * sum(
        share * 1j * omega * (1.0 / (1j * omega - pole) + 1.0 / (1j * omega - pole.conjugate()))
        for share, pole in zip((0.2, 0.1), poles, strict=True))
    assert found.magnitude(477.0) == pytest.approx(abs(exact), rel=0.02)


@pytest.mark.parametrize(("gain", "frequency_hz", "damping"), [
    (0.8, 150.0, 0.05), (-0.3, 60.0, 0.01), (0.5, 300.0, 0.3)])
def test_probe_finds_gain_sign_noise_vibration_and_creep(gain, frequency_hz, damping):
    stage = FilterStage(gain, frequency_hz, damping)
    found = stage.probed()
    assert found.gain_um_per_v == pytest.approx(gain, rel=0.05)
    assert found.rest.noise_rms_um == pytest.approx(0.01, rel=0.05)
    (found_hz, found_damping, _), *_ = found.response.modes
    assert found_hz == pytest.approx(frequency_hz, rel=0.01)
    assert found_damping == pytest.approx(damping, rel=0.1)
    assert found.creep.ended
    assert 0.5 * 2.0 < found.creep.time_s < 8.0 * 2.0


def test_steps_are_no_larger_than_noise_and_sensor_ask_for():
    stage = FilterStage()
    found = stage.probed()
    sizes_v = stage.sizes_v()
    assert all(later <= 2.0 * size * (1.0 + 1e-9)
               for size, later in zip(sizes_v[:-1], sizes_v[1:], strict=True))
    assert SIGNAL_TO_NOISE <= found.signal_to_noise <= 1.5 * SIGNAL_TO_NOISE
    assert max(sizes_v) == pytest.approx(found.step_v)
    largest_v = LIMITS.slew_limit_v_per_s / LIMITS.sample_rate_hz
    assert all(np.abs(np.diff(step.voltage_v)).max() <= largest_v for step in stage.played)
    assert all(step.voltage_v[0] == step.voltage_v[-1] == 0.0 for step in stage.played)


def test_steps_stop_growing_and_experiments_stay_within_a_narrow_sensor():
    limits = replace(LIMITS, displacement_min_um=-10.0, displacement_max_um=30.0)
    stage = FilterStage(noise_um=0.1, damping=0.02, limits=limits)
    found = stage.probed()
    assert found.signal_to_noise < SIGNAL_TO_NOISE
    assert -10.0 < stage.lowest_um < stage.highest_um < 30.0
    document = probe_file.probe_document(found, limits)
    usable = document.usable(limits)
    assert -10.0 < 0.8 * usable.voltage_min_v < 0.8 * usable.voltage_max_v < 30.0
    assert "as the sensor's range allows no more" in probe_file.probe_summary(document)


def test_slew_limit_is_kept_by_steps_and_by_the_experiments():
    limits = replace(LIMITS, slew_limit_v_per_s=4000.0)
    stage = FilterStage(limits=limits)
    document = probe_file.probe_document(stage.probed(), limits)
    assert max(stage.sizes_v()) > 1.0
    assert all(np.abs(np.diff(step.voltage_v)).max() <= 1.0 for step in stage.played)
    for name in EXPERIMENTS:
        experiment = named_experiment(name, document.usable(limits), document.fitted(name))
        assert np.abs(np.diff(experiment.voltage_v)).max() <= 1.0 + 1e-9


@pytest.mark.parametrize("noise_um", [0.0, 0.002])
def test_converter_coarser_than_the_noise_counts_as_noise(noise_um):
    found = FilterStage(noise_um=noise_um, resolution_um=0.05).probed()
    assert found.rest.noise_rms_um == pytest.approx(0.05 / np.sqrt(12.0), rel=0.01)
    assert found.signal_to_noise == pytest.approx(SIGNAL_TO_NOISE, rel=0.5)
    (found_hz, found_damping, _), = found.response.modes
    assert found_hz == pytest.approx(150.0, rel=0.01)
    assert found_damping == pytest.approx(0.05, rel=0.1)


def test_stage_that_does_not_move_is_told_and_moved_no_further_than_allowed():
    stage = FilterStage(gain=1e-6)
    with pytest.raises(ValueError, match="moves the sensor by .* look at the amplifier"):
        stage.probed()
    assert max(stage.sizes_v()) <= 0.3 * LIMITS.span_v + 1e-9


def test_sensor_out_of_its_range_at_rest_is_told_before_anything_moves():
    stage = FilterStage(limits=replace(LIMITS, displacement_min_um=10.0))
    with pytest.raises(ValueError, match="the sensor reads .* um at rest"):
        stage.probed()
    assert stage.sizes_v() == []


def test_periods_follow_the_speed_of_the_stage():
    slow, fast = (
        probe_file.probe_document(FilterStage(frequency_hz=frequency_hz, creep=(
            (0.04, 300.0 / frequency_hz),)).probed(), LIMITS)
        for frequency_hz in (50.0, 250.0))
    periods_s = [document.fitted("dynamics")["period_s"] for document in (slow, fast)]
    assert periods_s[0] == pytest.approx(5.0 * periods_s[1], rel=0.2)
    assert slow.fitted("creep")["period_s"] > fast.fitted("creep")["period_s"]
    top_hz = [document.fitted("validation")["tones"][-1][0] for document in (slow, fast)]
    assert top_hz == pytest.approx([65.0, 325.0], rel=0.03)


def test_file_of_a_probe_is_read_as_it_was_written_and_refused_for_another_stage(tmp_path):
    document = probe_file.probe_document(FilterStage().probed(), LIMITS)
    path = tmp_path / "probe.json"
    probe_file.save_probe(path, document)
    read = probe_file.load_probe(path)
    assert read == document
    assert read.fitted("diagnostic") == {}
    with pytest.raises(probe_file.ProbeFileError, match="voltage_max_v 120, the stage has 60"):
        read.usable(replace(LIMITS, voltage_max_v=60.0))
    path.write_text(path.read_text().replace('"piezo_probe"', '"piezo_model"'))
    with pytest.raises(probe_file.ProbeFileError, match="give a file of a probe"):
        probe_file.load_probe(path)


def test_noise_that_averages_do_not_remove_is_told_with_the_error_to_expect():
    quiet, noisy = (probe_file.probe_document(FilterStage(noise_um=noise_um).probed(), LIMITS)
                    for noise_um in (0.005, 0.5))
    assert quiet.expected.remarks == []
    assert "use a quieter sensor" in probe_file.probe_summary(noisy)


def test_error_to_expect_is_that_of_the_mean_of_as_many_samples():
    document = probe_file.probe_document(FilterStage(noise_um=0.08).probed(), LIMITS)
    dynamics, stage = document.experiments.dynamics, document.stage
    periods = round(dynamics.duration_s / dynamics.period_s)
    noise_um = 0.08 * np.random.default_rng(4).normal(size=(2000, periods)).mean(axis=1)
    step_um = dynamics.swing_v * abs(stage.gain_um_per_v)
    assert document.expected.dynamics_percent == pytest.approx(
        100.0 * noise_um.std() / step_um, rel=0.1)


@pytest.mark.parametrize("frequency_hz", [1400.0, 2600.0])
def test_vibration_near_or_above_half_the_sample_rate_is_told(frequency_hz):
    document = probe_file.probe_document(
        FilterStage(frequency_hz=frequency_hz, damping=0.03).probed(), LIMITS)
    assert any("use a faster clock" in remark for remark in document.expected.remarks)


@pytest.mark.long
def test_creep_that_outlasts_the_probe_is_told():
    creep = tuple((0.04, time_s) for time_s in (1.0, 6.0, 40.0, 250.0, 1500.0))
    document = probe_file.probe_document(FilterStage(creep=creep).probed(), LIMITS)
    assert any("the creep goes on after" in remark for remark in document.expected.remarks)
