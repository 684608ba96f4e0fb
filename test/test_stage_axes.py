# SPDX-License-Identifier: BSD-3-Clause
"""A stage of two axes: played, recorded, read, and stopped as a whole."""

import re
from dataclasses import replace
from importlib import resources
from pathlib import Path

import control
import numpy as np
import pytest
from piezo_interfaces.msg import Marks, SampleBlock
from piezo_interfaces.srv import StartTracking
from sensor_msgs.msg import JointState

from piezo_client import references, stage_command, stage_work
from piezo_client.client import GoalFailed
from piezo_client.stage import Stage
from piezo_common.gsf import Field, read_gsf, write_gsf
from piezo_controller.axes.stored_scan import StoredScan, read_scan, write_scan
from piezo_models import Coupling, IdentifiedAxes, save_axes_model
from piezo_models.axes.coupled import CoupledModel
from piezo_models.feedback_law.axes_law import AxesLaw, save_axes_law
from piezo_models.feedback_law.feedback_law import DeclaredPlant, LinearBlock
from piezo_recorder.images.scan_image import image_of
from piezo_recorder.reading.axes import read_axes
from piezo_ros.quality import SAMPLES
from piezo_sim.simulated_stage import SimulatedStage

AXES, SEED = ("x", "y"), 5
DEAF_FROM_S = 2.0
"""Of stage time: what connects to a stage takes a few milliseconds of it each time."""


@pytest.fixture(scope="module")
def xy(nodes):
    """The stage with all nodes."""
    return nodes.start("recorder", "identification", "controller", namespace="/xy", axes=AXES,
                       plant="xy", seed=SEED, **{"y.maximum_voltage_v": 80.0})


def circle(samples=800):
    phase = 2.0 * np.pi * np.arange(samples) / samples
    return np.column_stack([40.0 + 30.0 * np.cos(phase), 40.0 + 30.0 * np.sin(phase)])


def test_waveform_is_published_as_uploaded_and_answered_by_the_plant_to_the_bit(xy):
    xy.restart()
    result = xy.play(circle(), repeats=2)
    samples = xy.samples(result.last_sample)
    assert samples.gapless and all(tuple(block.axes) == AXES for block in samples.blocks)
    assert np.array_equal(samples.since(result.first_sample, 1600), np.tile(circle(), (2, 1)))
    assert np.array_equal(samples.flagged(SampleBlock.FLAG_PLAYING), np.tile(circle(), (2, 1)))
    plant = SimulatedStage("xy", SEED)
    plant.open()
    assert np.array_equal(samples.displacement_um, plant.exchange(samples.voltage_v))


def test_recording_holds_what_was_played_and_measured_of_both_axes(xy, tmp_path):
    with Stage("/xy") as stage:
        played = xy.beside(stage.play, circle(), 1e-4, directory=tmp_path)
    recording, = read_axes(played)
    assert recording.axes == AXES and recording.sample_period_s == 1e-4
    assert np.allclose(recording.voltage_v, circle(), rtol=1e-13)
    # 60 V, at 0.24 um/V of the less sensitive axis.
    assert np.all(np.ptp(recording.displacement_um, axis=0) > 14.0)


def test_marks_are_published_recorded_and_told_on_a_topic_of_their_own(xy, tmp_path):
    told = []
    xy.node.create_subscription(Marks, "marks", told.append, SAMPLES)
    marks = np.zeros(800, np.uint8)
    marks[[0, 400, 799]] = Marks.FRAME | Marks.LINE, Marks.PIXEL, Marks.PIXEL | Marks.BACKWARD
    xy.until(lambda: xy.node.count_publishers("/xy/marks"))
    with Stage("/xy") as stage:
        played = xy.beside(stage.play, circle(), 5e-5, directory=tmp_path, marks=marks)
    recording, = read_axes(played)
    assert np.array_equal(recording.marks, marks)
    xy.until(lambda: sum(len(each.sample) for each in told) == 3)
    samples = np.concatenate([each.sample for each in told]).astype(int)
    assert np.array_equal(np.diff(samples), [800, 798])  # two samples of the clock for each value
    assert [kind for each in told for kind in each.kind] == [6, 1, 9]
    stamps_s = [stamp.sec + 1e-9 * stamp.nanosec for each in told for stamp in each.stamp]
    assert np.allclose(stamps_s, samples / 40_000.0, atol=1e-9)
    with pytest.raises(GoalFailed, match="800 samples and 3 marks: give a mark for each sample"):
        xy.play(circle(), marks=[1, 2, 3])


@pytest.fixture
def planned(tmp_path):
    """A folder with a circle as `scan` writes it, without an inverse."""
    write_scan(StoredScan(AXES, 1e-4, circle()[:2], circle(), 0.28 * circle()), tmp_path / "plan")
    return tmp_path / "plan"


def test_planned_path_is_played_and_its_error_told_by_axis(xy, tmp_path, planned):
    with Stage("/xy") as stage:
        run = xy.beside(stage.scan, planned, directory=tmp_path)
    measured_um = run.recording().displacement_um
    assert any(np.array_equal(run.displacement_um, measured_um[first:first + 800])
               for first in range(len(measured_um) - 800))
    assert np.all((0.1 < run.error_percent) & (run.error_percent < 15.0))
    assert list(run.summary().rows[1][:2]) == ["y", pytest.approx(16.8)]


def test_voltages_of_a_path_are_learned_run_by_run_and_kept(xy, tmp_path, planned):
    s, frequency = control.tf("s"), 2.0 * np.pi * np.array([307.4, 364.9])
    modes = [control.ss(0.25 * w**2 / (s**2 + 0.03 * w * s + w**2)) for w in frequency]
    model = CoupledModel.from_control(control.sample_system(control.append(*modes), 1e-4), AXES)
    with Stage("/xy") as stage:
        first, _, third = xy.beside(
            stage.learn_scan, planned, model, runs=3, directory=tmp_path)
    assert max(third.error_percent) < 0.5 * max(first.error_percent)
    kept = read_scan(tmp_path / "learned")
    assert np.allclose(kept.voltage_v, third.scan.voltage_v, atol=1e-6)


def linear_model():
    """A model of modes and static gains alone, at the rate of the stage."""
    s, frequency = control.tf("s"), 2.0 * np.pi * np.array([307.4, 364.9])
    modes = [control.ss(0.25 * w**2 / (s**2 + 0.03 * w * s + w**2)) for w in frequency]
    return replace(
        CoupledModel.from_control(control.sample_system(control.append(*modes), 2.5e-5), AXES),
        operating_voltage_v=np.array([40.0, 40.0]), operating_displacement_um=np.full(2, 10.0))


def save_linear_model(path):
    model = linear_model()
    frequency_hz = np.geomspace(1.0, 1e4, 10)
    gain, modes = model.response(frequency_hz), model.poles_rad_per_s.size
    save_axes_model(path, IdentifiedAxes(
        model, np.array([[-20.0, 120.0]] * 2), Coupling(frequency_hz, gain, 1e-3 * np.abs(gain)),
        np.zeros(modes, complex), 0.0 * model.residues_um_per_v, np.zeros(2), np.zeros(2)))
    return path


def test_pattern_is_planned_played_and_made_into_images_by_one_command(
        nodes, tmp_path, capfd, monkeypatch, without_pictures):
    field = Field(0.01 * np.random.default_rng(1).normal(size=(60, 60)), (-10.0, -10.0),
                  (40.0, 40.0), "um")
    write_gsf(tmp_path / "specimen.gsf", field)
    stage = nodes.start("recorder", namespace="/scanned", axes=AXES, plant="xy",
                        specimen=str(tmp_path / "specimen.gsf"))
    save_linear_model(tmp_path / "model.json")
    monkeypatch.setattr(stage_work.signal, "signal", lambda *_: None)
    assert stage.beside(stage_command.main, [
        "--namespace", "scanned", "scan", "--pattern", "raster", "--size-um", "5", "5", "--lines",
        "12", "--rate-hz", "200", "--compare", "--model", str(tmp_path / "model.json"),
        "--feedback", str(integral_law(tmp_path / "law.json", operating_v=40.0)),
        "--specimen", str(tmp_path / "specimen.gsf"), "--output", str(tmp_path / "scan")]) == 0
    told = capfd.readouterr().out
    assert "Geometric error, RMS in pixels" in told and "no inverse, as measured" in told
    assert "inverse and feedback, as measured" in told
    assert (tmp_path / "scan" / "report.html").exists()
    image = read_gsf(tmp_path / "scan" / "inverse_as_measured.gsf")
    assert image.values.shape == (12, 12) and image.size_um == pytest.approx((5.0, 5.0 * 12 / 11))
    recording, = read_axes(tmp_path / "scan" / "inverse")
    assert list(recording.signals) == ["height_um", "camera"]
    assert np.sum(recording.marks & Marks.PIXEL > 0) == 2 * 144
    again = image_of(recording)
    np.testing.assert_allclose(again.values, image.values, atol=1e-6)
    led = image_of(read_axes(tmp_path / "scan" / "scan")[0])
    shown = read_gsf(tmp_path / "scan" / "inverse_and_feedback_as_measured.gsf")
    np.testing.assert_allclose(led.values, shown.values, atol=1e-6)
    assert len(led.visited_values) == 144 and np.isfinite(led.visited_um).all()


def test_array_without_a_column_for_each_axis_is_refused_before_it_is_sent(xy, tmp_path):
    with Stage("/xy") as stage, pytest.raises(ValueError, match="the axes x, y: give a column for"):
        xy.beside(stage.play, np.zeros((10, 3)), directory=tmp_path)


def test_limits_are_those_of_each_axis_and_described_as_such(xy):
    with pytest.raises(GoalFailed, match=r"y: voltage sample 0 is 90 V, outside \[-20, 80\] V"):
        xy.play(np.array([[90.0, 90.0]]))
    with Stage("/xy") as stage:
        described = stage.description
    assert [(axis.name, axis.maximum_voltage_v) for axis in described.axes] == [
        ("x", 120.0), ("y", 80.0)]
    assert described.maximum_voltage_v == 80.0


def test_each_axis_has_a_joint(xy):
    states = []
    xy.node.create_subscription(JointState, "joint_states", states.append, 10)
    while not states:
        # Held, as the last state would be of any place on the way back.
        xy.play(np.full((4000, 2), [40.0, 20.0]), hold_at_end=True)
        xy.spin_until(lambda: states, 0.2)
    assert states[-1].name == ["stage_x", "stage_y"]
    assert all(1e-6 < place < 2e-5 for place in states[-1].position)
    xy.play([0.0])


def test_fault_of_one_axis_brings_both_to_rest(nodes, tmp_path):
    plant = tmp_path / "deaf.yaml"
    text = (resources.files("piezo_sim") / "xy.yaml").read_text(encoding="utf-8")
    before, sensor, after = text.rpartition("      - effect: displacement_sensor\n")
    plant.write_text(before + "      - effect: silent_sensor\n" + "".join(
        f'        {name}: {{value: {value}, unit: s, source: "of the test"}}\n'
        for name, value in (("begin_s", DEAF_FROM_S), ("end_s", 100.0))) + sensor + after)
    stage = nodes.start(namespace="/deaf", axes=AXES, plant=str(plant))
    with pytest.raises(GoalFailed, match="y: the sensor's reading is not a number"):
        while True:
            stage.play(circle(4000))
    samples = stage.samples()
    assert np.array_equal(samples.voltage_v[-1], [0.0, 0.0])
    with pytest.raises(GoalFailed, match="the stage is stopped"):
        stage.play(circle())


GAINS_UM_PER_V = np.array([0.3, 0.25])
"""About those of the plant."""


def integral_law(path, factor=1.0, operating_v=70.0):
    """Write a law that integrates the error of each axis, for gains that are off by a factor."""
    one = np.eye(2)
    late = DeclaredPlant(LinearBlock(0.5 * one, one, 0.5 * one, 0.0 * one),
                         factor * GAINS_UM_PER_V[None, :])
    tick = LinearBlock(one, 0.05 * one, np.diag(1.0 / GAINS_UM_PER_V / factor), 0.0 * one)
    save_axes_law(path, AxesLaw(AXES, 25e-6, 40, tick, np.diag(factor * GAINS_UM_PER_V), late,
                                GAINS_UM_PER_V * operating_v, {}, {}))
    return path


@pytest.fixture
def slow_circle(tmp_path):
    """A folder with a circle at the stage's sample rate, whose positions are only about right."""
    voltage_v = circle(40_000)
    write_scan(StoredScan(AXES, 25e-6, np.tile(voltage_v[0], (800, 1)), voltage_v,
                          GAINS_UM_PER_V * voltage_v), tmp_path / "slow")
    return tmp_path / "slow"


def test_law_on_board_removes_the_errors_of_a_planned_path(xy, tmp_path, slow_circle):
    xy.restart()
    law = integral_law(tmp_path / "law.json")
    marks = np.zeros(40_000, np.uint8)
    marks[[0, 7, 39_999]] = Marks.FRAME | Marks.PIXEL, Marks.PIXEL, Marks.LINE
    marked = replace(read_scan(slow_circle), marks=marks)
    with Stage("/xy") as stage:
        without, led = (xy.beside(stage.scan, marked, 2, tmp_path, feedback=feedback)
                        for feedback in (None, law))
    assert np.all(np.abs(without.offset_um) > 0.1) and np.all(np.abs(led.offset_um) < 0.003)
    assert np.all(led.error_percent < 0.3 * without.error_percent)
    recording = led.recording()
    added_v = recording.voltage_v[recording.tracking][-40_000:] - circle(40_000)
    assert np.allclose(np.mean(added_v, axis=0) * GAINS_UM_PER_V, -without.offset_um, rtol=0.2)
    for run in without, led:
        recording, = read_axes(run)
        first = run.before_samples
        assert not recording.marks[:first].any()
        assert np.array_equal(recording.marks[first:first + 80_000], np.tile(marks, 2))


def test_run_with_a_law_for_another_stage_ends_at_rest_with_the_cause(xy, tmp_path, slow_circle):
    law = integral_law(tmp_path / "law.json", 5.0)
    with Stage("/xy") as stage:
        with pytest.raises(GoalFailed, match=r"the end: x: the stage moved by 0.\d* um/V, and the"):
            xy.beside(stage.scan, slow_circle, 2, tmp_path, feedback=law)
        stage.reset()


def test_controller_tracks_a_path_with_and_without_a_law_and_tells_the_error_of_each_axis(
        xy, tmp_path):
    model, law = save_linear_model(tmp_path / "model.json"), tmp_path / "law.json"
    figure = references.path("lissajous", 2.0, (8.0, 6.0), 2)
    integral_law(law, operating_v=40.0)
    with Stage("/xy") as stage:
        without, led = (
            xy.beside(stage.track, figure, model, mode, 1.0, tmp_path, controller)
            for mode, controller in (("feedforward", ""), ("composite", law)))
        with pytest.raises(GoalFailed, match="in the mode 'pid': use one of open_loop, feedf"):
            xy.beside(stage.track, figure, model, "pid", 1.0, tmp_path)
    assert led.e_rms_percent < 0.3 * without.e_rms_percent < 30.0
    for run in without, led:
        told = re.findall(r"([xy]): e_rms (\S+) %, largest error (\S+) um", run.message)
        assert [axis for axis, *_ in told] == ["x", "y"]
        for at, worst in (1, run.e_rms_percent), (2, run.largest_error_um):
            assert max(float(each[at]) for each in told) == pytest.approx(worst, rel=1e-3)
    recording = led.recording()
    assert "scan.json" in recording.attachments
    assert np.sum(read_axes(led)[0].marks & Marks.FRAME > 0) == 2  # at 0 and 1 s
    assert recording.axes == AXES and np.sum(recording.tracking) > 44_000
    assert np.ptp(recording.displacement_um[-60_000:-10_000], axis=0).min() > 5.0


def test_what_takes_one_axis_refuses_by_name(xy, tmp_path):
    loaded = xy.load(np.zeros(40))
    assert not loaded.success and "the stage has the axes x, y: give a voltage of each" in (
        loaded.message)
    assert "nobody answers the blocks of several axes" in xy.call(
        StartTracking, "start_tracking", feedback=True).message
    with pytest.raises(GoalFailed, match="identification does this for a stage of one axis, .* the "
                                         "recordings to ./run piezo_identification identify or"):
        xy.identify(tmp_path)


def test_experiments_move_all_axes_and_are_read_as_periods_that_settled(xy, tmp_path):
    folder = xy.run_experiment("multisine", tmp_path).recording
    recordings = [each for path in sorted(Path(folder).iterdir()) for each in read_axes(path)]
    assert len(recordings) == 4 and {each.periods for each in recordings} == {2}
    first_v, second_v = np.split(recordings[0].voltage_v, 2)
    assert len(first_v) >= 4000 and np.array_equal(first_v, second_v)
    first_um, second_um = np.split(recordings[0].displacement_um, 2)
    assert np.all(np.std(first_um - second_um, axis=0) < 0.05 * np.std(first_um, axis=0))
