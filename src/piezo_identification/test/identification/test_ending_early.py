# SPDX-License-Identifier: BSD-3-Clause
"""An identification that ends early writes the best model so far, said to be unfinished."""

import os
from itertools import count

import pytest

from piezo_common.budget import Budget
from piezo_identification.estimators.frequency_response.response_model import ResponseOrder
from piezo_identification.experiments import catalogue as experiments
from piezo_identification.identification import linear_dynamics
from piezo_identification.identification.estimated_loops import DensityOptions
from piezo_identification.identification.identify import identify
from piezo_identification.report.identification_report import identification_sentence
from piezo_models.model_file import load_model, save_model
from piezo_recorder.reading.reader import read_recording

# Which of them is best is not asked here, and takes most of an identification.
ASKED = {"order": ResponseOrder(None, 2, 0), "density": DensityOptions(20, 1e-10, 1e-10)}


@pytest.fixture(scope="module", autouse=True)
def dynamics_once():
    """Estimate the dynamics of the recordings once: all identifications here have the same.

    `make long` estimates them anew in each.
    """
    estimate, found = linear_dynamics.estimate_dynamics, []

    def once(*given, **options):
        if not found or "LONG_TESTS" in os.environ:
            found[:] = [estimate(*given, **options)]
        return found[0]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(linear_dynamics, "estimate_dynamics", once)
        yield


@pytest.fixture(scope="module")
def recordings(play, csv_of, tmp_path_factory):
    played = {
        "dynamics": play(experiments.dynamics(duration_s=0.2), 1),
        "hysteresis": play(experiments.hysteresis(level_count=8, harmonic_period_s=1.0), 1, 1000.0),
        "validation": play(experiments.validation(arc_s=0.05, tones_s=0.2), 2)}
    folder = tmp_path_factory.mktemp("recordings")
    return {name: read_recording(csv_of(each, folder / f"{name}.csv"))
            for name, each in played.items()}


@pytest.fixture(scope="module")
def whole(recordings):
    return identify(**recordings, **ASKED)


@pytest.fixture(scope="module")
def step_by_step(recordings):
    """What there is before the one fit, and what was told of it."""
    told = []
    return identify(**recordings, **ASKED, note=told.append,
                    budget=Budget(1.0, count().__next__)), told


def interrupted_at(beginning):
    def progress(stage, fraction):
        if stage.startswith(beginning):
            raise KeyboardInterrupt
    return progress


@pytest.mark.long
def test_an_identification_that_is_done_is_not_unfinished(whole):
    assert whole.unfinished == "" and "unfinished" not in whole.shortfall()


@pytest.mark.parametrize("stage", [
    "everything together", pytest.param("with", marks=pytest.mark.long)])
def test_ctrl_c_in_the_one_fit_leaves_the_best_model_so_far(
        recordings, step_by_step, stage, tmp_path):
    found = identify(**recordings, **ASKED, progress=interrupted_at(stage))
    assert found.unfinished.startswith("interrupted; not tried: ")
    assert found.unfinished in identification_sentence(found)
    save_model(tmp_path / "model.json", found)
    read = load_model(tmp_path / "model.json")
    assert read.unfinished == found.unfinished
    assert read.shortfall().startswith("the model is unfinished: interrupted; not tried: ")
    assert found.errors["e_y_percent"] < 1.1 * step_by_step[0].errors["e_y_percent"]


def test_ctrl_c_before_there_is_a_model_leaves_none(recordings):
    with pytest.raises(KeyboardInterrupt):
        identify(**recordings, **ASKED, progress=interrupted_at("dynamics"))


def test_a_budget_that_is_over_at_once_leaves_the_separate_steps(step_by_step):
    found, told = step_by_step
    assert found.unfinished.startswith("the time of 1 s does not suffice; not tried: ")
    table = next(text for text in told if text.startswith("one fit of the whole model"))
    assert table.splitlines()[-1].startswith("step by step") and "<- written" in table
    axes, = table.plot().axes
    assert [tick.get_text() for tick in axes.get_yticklabels()] == ["step by step"]
    assert [line.get_fillstyle() for line in axes.lines] == ["full"]


@pytest.mark.long  # a whole identification
def test_a_budget_that_is_large_enough_changes_nothing(recordings, whole):
    found = identify(**recordings, **ASKED, budget=Budget(1e9, count().__next__))
    assert found.unfinished == ""
    assert found.errors == whole.errors
