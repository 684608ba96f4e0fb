# SPDX-License-Identifier: BSD-3-Clause
"""Extended models that are used in place of others, and those that cannot be."""

from dataclasses import replace
from pathlib import Path

import pytest

from piezo_controller.tracking.accepted_models import AcceptedModels, ModelText
from piezo_controller.tracking.feedbacks import Feedbacks, FeedbackSettings
from piezo_controller.tracking.tracking_modes import StageClock
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.identified_model import IdentifiedModel
from piezo_models.model_file import save_model

CLOCK = StageClock()


def read(path):
    return Path(path).read_text(encoding="utf-8")


def with_modes(model, *frequencies_rad_per_s):
    return replace(model, dynamics=replace(
        model.dynamics, mode_frequencies_rad_per_s=frequencies_rad_per_s))


@pytest.fixture
def saved(tmp_path):
    def save(name, model):
        path = tmp_path / name
        save_model(path, IdentifiedModel(model, (-20.0, 120.0)))
        return ModelText(str(path), read(path))

    return save


@pytest.fixture(scope="module")
def feedbacks(short_search):
    return Feedbacks(FeedbackSettings(), CLOCK)


def test_an_extended_model_is_used_until_it_is_withdrawn(stage_model, saved, feedbacks):
    model, extended = (saved("model.json", stage_model),
                       saved("extended.json", with_modes(stage_model, 2846.0, 5056.0)))
    other = saved("other.json", with_modes(stage_model, 2846.0, 4800.0))
    accepted = AcceptedModels()
    assert accepted.in_place_of(model, read) is model
    accepted.accept(model, extended, feedbacks.check_model)
    assert accepted.in_place_of(model, read) is extended
    assert accepted.in_place_of(other, read) is other
    accepted.withdraw(model)
    assert accepted.in_place_of(model, read) is model


def taken(*_):
    """Take any model, without a design for it."""


def test_what_cannot_be_taken_is_refused_and_the_one_before_stays(stage_model, saved):
    model, extended = (saved("model.json", stage_model),
                       saved("extended.json", with_modes(stage_model, 2846.0, 5056.0)))
    accepted = AcceptedModels()
    accepted.accept(model, extended, taken)
    hysteresis = stage_model.hysteresis
    narrower = replace(stage_model, hysteresis=PreisachModel(
        -10.0, 110.0, hysteresis.density_um_per_v2, hysteresis.offset_um))
    with pytest.raises(ValueError, match="narrower.json has another hysteresis, from -10 to 110 V"):
        accepted.accept(model, saved("narrower.json", narrower), taken)
    assert accepted.in_place_of(model, read) is extended


def test_model_of_another_stage_is_refused_before_anything_is_designed(stage_model, saved):
    hysteresis = stage_model.hysteresis
    first, second = stage_model.dynamics.mode_frequencies_rad_per_s
    for other, reason in (
            (with_modes(stage_model, 3 * first, 3 * second), "a mode of 1359 Hz where"),
            (replace(stage_model, hysteresis=replace(
                hysteresis, density_um_per_v2=0.4 * hysteresis.density_um_per_v2)), "a gain of")):
        with pytest.raises(ValueError, match=f"is of another stage .* with {reason}"):
            AcceptedModels().accept(saved("model.json", stage_model), saved("other.json", other),
                                    lambda *_: pytest.fail("designed"))


@pytest.mark.long  # a design far from the thesis' stage takes 10 s
def test_a_feedback_that_is_unstable_with_the_present_model_is_refused(stage_model, feedbacks):
    far = with_modes(stage_model, 200.0, 300.0)
    with pytest.raises(ValueError, match="the extended model is unstable with the model that it"):
        feedbacks.check_model(far, "1" * 64, stage_model)


def test_an_extended_model_that_was_changed_since_is_refused(stage_model, saved):
    model, extended = (saved("model.json", stage_model),
                       saved("extended.json", with_modes(stage_model, 2846.0, 5056.0)))
    accepted = AcceptedModels()
    accepted.accept(model, extended, lambda *_: None)
    saved("extended.json", with_modes(stage_model, 2846.0, 5100.0))
    with pytest.raises(ValueError, match="extended.json has been changed since it was accepted"):
        accepted.in_place_of(model, read)
