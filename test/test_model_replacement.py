# SPDX-License-Identifier: BSD-3-Clause
"""A model accepted while a run goes on: feedforward and law go over in one tick, or stay."""

import re
from dataclasses import replace

import numpy as np
import pytest
from piezo_interfaces.msg import FeedbackLaw, Reference, SampleBlock, StateSpace
from piezo_interfaces.srv import LoadFeedback, ReplaceFeedforward, StartTracking
from replaced import replaced
from short_design import FEW_SCALINGS

from piezo_client.client import GoalFailed
from piezo_client.model_offers import accept_extended_model
from piezo_controller.feedback.controller_file import save_controller
from piezo_controller.feedback.feedback_design import design_feedback
from piezo_controller.feedback.synthesis.weights import load_weights
from piezo_controller.references import reference as references
from piezo_controller.tracking.tracking_modes import StageClock, plan_mode
from piezo_models.identified_model import IdentifiedModel
from piezo_models.model_file import save_model
from piezo_recorder.reading.reader import read_recording

TICK, RATE_HZ, PERIOD = 40, 40_000, 800
FADED = 800  # samples: the way from one feedforward to the next
GOES_ON_S = 3600.0
REFERENCE = {"kind": "multi_frequency", "frequency_hz": [50.0, 400.0, 750.0],
             "amplitude_um": [20.0, 8.0, 4.0], "centre_um": 57.0}
FASTER = 1.03


@pytest.fixture(scope="module")
def files(near_model, tmp_path_factory):
    """A model, one whose second mode is faster, one of a stage that moves less; a controller."""
    directory = tmp_path_factory.mktemp("files")
    dynamics, hysteresis = near_model.dynamics, near_model.hysteresis
    first, second = dynamics.mode_frequencies_rad_per_s
    models = {
        "model": near_model,
        "faster": replace(near_model, dynamics=replace(
            dynamics, mode_frequencies_rad_per_s=(first, FASTER * second))),
        "weaker": replace(near_model, hysteresis=replace(
            hysteresis, density_um_per_v2=0.6 * hysteresis.density_um_per_v2))}
    for name, model in models.items():
        save_model(directory / f"{name}.json", IdentifiedModel(model, (-20.0, 120.0)))
    with replaced(*FEW_SCALINGS):
        save_controller(directory / "controller.json", design_feedback(
            near_model, load_weights(), delay_ticks=0))
    return directory, models


@pytest.fixture(scope="module", params=[
    "lockstep", pytest.param("paced", marks=pytest.mark.long)])
def stage(request, nodes, files):
    """A stage whose controller uploads its feedback."""
    return nodes.start(
        "recorder", "controller", namespace=f"/{request.param}", timing=request.param,
        node_parameters={"controller": {"controller_file": str(files[0] / "controller.json")}})


@pytest.fixture
def run(stage, files, tmp_path):
    """A run in composite mode that has come to its periods."""
    stage.forget()
    goal = stage.begin("track", reference=Reference(**REFERENCE), mode="composite",
                       model=str(files[0] / "faster.json"), duration_s=GOES_ON_S,
                       directory=str(tmp_path))
    goes_on(stage, 200)
    return goal


def goes_on(stage, ticks, since=None):
    """Wait until the run is so many ticks further, than now or than a tick."""
    wanted = ticks + (stage.blocks[-1].tick if since is None else since)
    stage.until_any(lambda block: block.flags & SampleBlock.FLAG_TRACKING and block.tick > wanted)


def planned(model):
    return plan_mode("composite", references.Reference(
        "multi_frequency", tuple(REFERENCE["frequency_hz"]), tuple(REFERENCE["amplitude_um"]), (),
        REFERENCE["centre_um"]), model, StageClock(), GOES_ON_S)


def fastest_v(voltage_v):
    """Return the harmonic of 750 Hz of a period, complex, which no feedback of 1 kHz changes."""
    return np.fft.rfft(voltage_v)[15] / PERIOD


def test_feedforward_and_law_go_over_in_one_tick_without_a_step(stage, files, run):
    directory, models = files
    told = accept_extended_model(stage, directory / "faster.json", directory / "model.json")
    at_s = re.search(r"from ([\d.]+) s of the present run on", told)
    assert at_s, told
    first = next(block for block in stage.blocks if block.flags & SampleBlock.FLAG_TRACKING)
    goes_on(stage, 200, first.tick + round(float(at_s[1]) * RATE_HZ / TICK))
    _, result = stage.cancel(run)
    accept_extended_model(stage, directory / "faster.json", "")

    recording = read_recording(result.recording)
    tracked = recording.select(recording.has(SampleBlock.FLAG_TRACKING))
    assert np.array_equal(np.diff(tracked.sample_index), np.ones(len(tracked.voltage_v) - 1))
    old_v, new_v = (planned(models[name]).voltage_v(0, tracked.voltage_v.size)
                    for name in ("faster", "model"))
    swap = round(float(at_s[1]) * RATE_HZ / TICK) * TICK
    difference_v = np.abs(new_v - old_v).max()
    assert difference_v > 0.1
    # What is added to the feedforward goes on: a bump would be as large as the difference.
    added_v = tracked.voltage_v - old_v
    # The feedback itself makes a step a tick.
    usual_v = np.abs(np.diff(added_v[swap - 21 * TICK : swap : TICK])).max()
    assert abs(added_v[swap] - added_v[swap - 1]) < max(0.05 * difference_v, 2.0 * usual_v)
    whole = -(-(swap + FADED) // PERIOD) * PERIOD
    before, after = slice(swap - PERIOD, swap), slice(whole, whole + PERIOD)
    apart_v = abs(fastest_v(new_v[after]) - fastest_v(old_v[after]))
    for part, plan_v in ((before, old_v), (after, new_v)):
        left_v = fastest_v(tracked.voltage_v[part]) - fastest_v(plan_v[part])
        assert abs(left_v) < 0.1 * apart_v
    # The model that is accepted is nearer to the stage: on the way to it nothing gets worse.
    error_um = tracked.displacement_um - planned(models["model"]).expected_um(
        0, tracked.voltage_v.size)
    usual_um = np.abs(error_um[swap - 2 * PERIOD:swap]).max()
    assert np.abs(error_um[swap:whole]).max() < 1.2 * usual_um
    assert error_um[after].std() < 0.5 * error_um[before].std()


def test_model_with_which_the_reference_is_out_of_reach_leaves_what_there_was(stage, files, run):
    directory, models = files
    with pytest.raises(GoalFailed, match="is within reach; what was used before stays"):
        accept_extended_model(stage, directory / "faster.json", directory / "weaker.json")
    goes_on(stage, 200)
    _, result = stage.cancel(run)
    recording = read_recording(result.recording)
    tracked = recording.select(recording.has(SampleBlock.FLAG_TRACKING))
    old_v = planned(models["faster"]).voltage_v(0, tracked.voltage_v.size)
    end = tracked.voltage_v.size // PERIOD * PERIOD
    last = slice(end - PERIOD, end)
    before_v = fastest_v(tracked.voltage_v[end // 2 // PERIOD * PERIOD:][:PERIOD])
    assert abs(fastest_v(tracked.voltage_v[last]) - before_v) < 0.02 * abs(before_v)
    assert abs(fastest_v(old_v[last]) - before_v) < 0.1 * abs(before_v)


def test_stage_that_refuses_a_law_within_a_run_plays_on(nodes):
    stage = nodes.start(namespace="/refusing")
    once_v = np.linspace(0.0, 30.0, 100 * TICK)
    silent = FeedbackLaw(
        tick=StateSpace(a=[0.5], b=[1.0], c=[0.0], d=0.0), observer=[0.0], max_feedback_v=20.0,
        once_expected_um=[0.0], model=StateSpace(a=[0.9], b=[0.1], c=[1.0]),
        model_gains_um_per_v=[0.3])
    loud = FeedbackLaw(
        tick=StateSpace(a=[1.0], b=[1.0], c=[1.0], d=1.0), observer=[0.5], max_feedback_v=20.0,
        once_expected_um=[0.0], model=silent.model, model_gains_um_per_v=[100.0])
    assert stage.load(once_v).success
    assert stage.call(LoadFeedback, "load_feedback", law=silent).success
    begun = stage.call(StartTracking, "start_tracking", onboard=True)

    def ask(run, law, factor):
        return stage.call(ReplaceFeedforward, "replace_feedforward", run=run, onboard=True, law=law,
                          once_voltage_v=list(factor * once_v))

    goes_on(stage, 120, begun.first_tick)
    refused = ask(begun.run, loud, 1.1)
    assert "replace_feedforward refused: the feedback law is not stable" in refused.message
    assert f"run {begun.run - 1} does not go on" in ask(begun.run - 1, silent, 1.1).message
    goes_on(stage, 100)
    assert stage.blocks[-1].voltage_v[-1] == 30.0
    replaced = ask(begun.run, silent, 1.1)
    assert replaced.success and replaced.first_tick > begun.first_tick + 160
    goes_on(stage, 100, replaced.first_tick)
    assert stage.blocks[-1].voltage_v[-1] == pytest.approx(33.0)
    assert stage.trigger("stop_tracking").success
    stage.samples()
    assert "does not track" in ask(begun.run, silent, 1.0).message
