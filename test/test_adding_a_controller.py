# SPDX-License-Identifier: BSD-3-Clause
"""The controller of docs/adding_a_controller.md does on a stage what the page says."""

import json
import re
from dataclasses import replace
from pathlib import Path

import control
import numpy as np
import pytest
import yaml
from piezo_interfaces.msg import SampleBlock
from replaced import replaced
from short_design import FEW_SCALINGS

from piezo_controller.feedback.controller_file import (
    ControllerFileError,
    load_controller,
    load_stabilising_controller,
)
from piezo_controller.feedback.feedback_before_inverse import FeedbackBeforeInverse
from piezo_controller.feedback.feedback_design import design_feedback, feedback_from_control
from piezo_controller.feedback.multirate_feedback import MultirateFeedback
from piezo_controller.feedback.synthesis.weights import load_weights
from piezo_controller.references.reference import Reference
from piezo_controller.tracking.tracking_modes import StageClock, plan_mode
from piezo_controller.tracking.tracking_run import TrackingRun
from piezo_models.cascade import StageModel
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.identified_model import IdentifiedModel
from piezo_models.model_file import save_model
from piezo_studies.thesis.offline_loop import play_run

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "adding_a_controller.md").read_text(encoding="utf-8")
STAGE = StageClock()
HUM_UM, HUM_HZ = 0.5, 50.0
RUN_SAMPLES, SETTLED_SAMPLES = 28_000, 12_000


def block(language):
    """The code of the page in one language."""
    return re.search(rf"```{language}\n(.*?)```", PAGE, re.S)[1]


@pytest.fixture(scope="module")
def made(plain_model, tmp_path_factory):
    """The controller file that the page's code writes, in a directory with an identified model."""
    directory = tmp_path_factory.mktemp("lab")
    (directory / "runs" / "first").mkdir(parents=True)
    save_model(directory / "runs/first/model.json", IdentifiedModel(plain_model, (-20.0, 120.0)))
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(directory)
        exec(compile(block("python"), "hum_controller.py", "exec"), {})
    return directory / "runs/first/hum_controller.json"


def hum_left_um(model, controller):
    """Amplitude at 50 Hz of a shaken stage's error in the loop, once it has settled."""
    plan = plan_mode("composite", Reference("harmonic", (10.0,), (20.0,), (0.0,), 50.0), model,
                     STAGE, RUN_SAMPLES * STAGE.sample_period_s)
    run = TrackingRun(plan, RUN_SAMPLES, MultirateFeedback(controller), STAGE.tick_s)
    memory, played = model.memory(), 0

    def exchange(voltage_v):
        nonlocal played
        time_s = (played + np.arange(voltage_v.size)) * STAGE.sample_period_s
        played += voltage_v.size
        return (model.simulate(voltage_v, STAGE.sample_period_s, memory)
                + HUM_UM * np.sin(2.0 * np.pi * HUM_HZ * time_s))

    measured_um = play_run(run, plan, exchange, STAGE.samples_per_tick).displacement_um
    first = run.total_samples - SETTLED_SAMPLES
    error_um = measured_um[first:run.total_samples] - plan.expected_um(first, SETTLED_SAMPLES)
    time_s = np.arange(SETTLED_SAMPLES) * STAGE.sample_period_s
    return 2.0 * abs(np.mean(error_um * np.exp(-2j * np.pi * HUM_HZ * time_s)))


def test_controller_of_the_page_takes_off_the_hum_that_h_infinity_leaves(
        plain_model, made):
    controller = load_stabilising_controller(
        made, plain_model, STAGE.tick_s, STAGE.sample_period_s)
    assert hum_left_um(plain_model, controller) < 0.01 * HUM_UM
    with replaced(*FEW_SCALINGS):
        feedback = design_feedback(plain_model, load_weights())
    assert hum_left_um(plain_model, feedback) > 0.9 * HUM_UM


def test_file_of_the_page_is_refused_at_another_tick_and_for_a_stage_that_changed(
        plain_model, made):
    with pytest.raises(ControllerFileError, match="the stage's tick is 0.002 s"):
        load_stabilising_controller(made, plain_model, 2e-3, STAGE.sample_period_s)
    grown = StageModel(
        PreisachModel(-20.0, 120.0, 6.0 * plain_model.hysteresis.density_um_per_v2, -9.0),
        plain_model.creep, plain_model.dynamics)
    with pytest.raises(ControllerFileError, match="does not stabilise the model"):
        load_stabilising_controller(made, grown, STAGE.tick_s, STAGE.sample_period_s)


def test_node_of_the_page_holds_a_displacement_and_gives_the_number_of_its_run():
    scope, answers = {}, []
    exec(re.search(r"```python\n(# hold_controller.py\n.*?)```", PAGE, re.S)[1], scope)
    controller = scope["HoldController"](run=7, target_um=3.0, publish=answers.append)
    tracking, displacement_um = SampleBlock.FLAG_TRACKING, 0.0
    controller.take(SampleBlock(tick=1, displacement_um=[9.0]))
    for tick in range(200):
        controller.take(SampleBlock(
            tick=tick, flags=tracking, displacement_um=[displacement_um] * 40))
        displacement_um = answers[-1].voltage_v  # of a stage of 1 um/V
    assert displacement_um == pytest.approx(3.0, abs=1e-3)
    assert {answer.run for answer in answers} == {7}
    assert [answer.tick for answer in answers] == list(range(200))


def test_fields_of_the_file_are_those_of_the_page(made):
    rows = re.search(r"\| field \|(.*?)\n\n", PAGE, re.S)[1].splitlines()[2:]
    named = [name for row in rows for name in re.findall(r"`(\w+)`", row.split("|")[1])]
    assert sorted(named) == sorted(json.loads(made.read_text()))


def test_parameter_file_of_the_page_fits_the_node():
    given, = yaml.safe_load(block("yaml")).values()
    node = (ROOT / "src/piezo_controller/piezo_controller/node/controller_node.py").read_text()
    assert all(f'"{name}"' in node for name in given["ros__parameters"])


@pytest.mark.parametrize(("system", "message"), [
    (control.tf([1.0], [1.0, 1.0]), "no sample period"),
    (control.ss([], [], [], [[0.1]], 1e-3), "no state"),
    (control.ss([[1.0]], [[1.0, 0.0]], [[1.0]], [[0.0, 0.0]], 1e-3), "2 inputs and 1 outputs"),
    (control.tf([1.0, 0.0], [1.0, -1.0], 1.1e-5), "no multiple of the sample clock"),
    (control.tf([5.0, 0.0], [1.0, -1.0], 1e-3), "does not stabilise"),
])
def test_system_that_is_no_feedback_is_refused(plain_model, system, message):
    with pytest.raises(ValueError, match=message):
        feedback_from_control(system, plain_model)


def test_file_with_an_empty_report_is_refused_only_before_the_inverse(plain_model, made):
    controller = replace(load_controller(made), report={})
    assert MultirateFeedback(controller).step(1.0, 0.0) > 0.0
    with pytest.raises(ValueError, match="has no hysteresis_gain_um_per_v"):
        FeedbackBeforeInverse(controller, plain_model, None, STAGE.samples_per_tick)


def test_system_comes_through_the_file_as_it_is(plain_model, made):
    system = load_controller(made).state_space()
    assert feedback_from_control(system, plain_model).report["order"] == system.nstates == 3
