# SPDX-License-Identifier: BSD-3-Clause
import json
from dataclasses import replace

import numpy as np
import pytest

from piezo_models.feedback_law.axes_law import (
    AxesLaw,
    LawFileError,
    load_axes_law,
    save_axes_law,
)
from piezo_models.feedback_law.feedback_law import (
    DeclaredPlant,
    FeedbackLaw,
    FeedbackLawError,
    LinearBlock,
)
from piezo_models.feedback_law.law_check import check_law
from piezo_models.feedback_law.running_axes_law import RunningAxesLaw
from piezo_models.feedback_law.running_law import RunningLaw

AXES, SAMPLES = ("x", "y"), 4
GAINS = np.array([[0.2, 0.3], [0.25, 0.4]])
INTEGRALS = LinearBlock.of(np.eye(2), np.diag([1.0, 0.5]), np.eye(2), np.diag([0.4, 0.2]), 2)
LAG = LinearBlock.of(0.9 * np.eye(2), np.eye(2), [[0.1, 0.01], [-0.02, 0.1]], np.zeros((2, 2)), 2)
OBSERVER = np.array([[0.3, 0.0], [0.0, 0.1]])


def law_of(**changes):
    rows = np.arange(40.0)[:, None] * [0.01, -0.02]
    return replace(FeedbackLaw(
        INTEGRALS, OBSERVER, 1.5, rows[:6], rows[6:30], DeclaredPlant(LAG, GAINS), start_sample=8,
        fade_samples=12, axes=AXES), **changes)


def of_one_axis(law, at):
    """Return the law of one axis of a law that does not couple them."""
    tick = LinearBlock.of(law.tick.a[at, at], law.tick.b[at, at], law.tick.c[at, at],
                          law.tick.d[at, at])
    return replace(law, tick=tick, observer=law.observer[at, at:at + 1], axes=(),
                   once_um=law.once_um[:, at], period_um=law.period_um[:, at],
                   plant=DeclaredPlant(LinearBlock.of([0.9], [1.0], [0.1], [0.0]), GAINS[:, at]))


@pytest.mark.parametrize("changes", [
    {}, {"delay_ticks": 1}, {"fade_samples": 0}, {"start_sample": 0},
    {"once_um": np.zeros((0, 2))}, {"period_um": np.zeros((0, 2))}])
def test_uncoupled_law_gives_the_voltages_of_a_law_for_each_axis(changes):
    law = law_of(**changes)
    both = RunningAxesLaw(law, SAMPLES, 0.4)
    alone = [RunningLaw(of_one_axis(law, at), SAMPLES, largest_step_v=0.4) for at in range(2)]
    measured_um = np.random.default_rng(2).normal(size=(30, SAMPLES, 2))
    for tick, displacement_um in enumerate(measured_um):
        added_v = both.begin(np.zeros((SAMPLES, 2)))
        for at, each in enumerate(alone):
            assert np.allclose(added_v[:, at], each.begin(np.zeros(SAMPLES)), atol=1e-12)
        if tick % 7 == 6:
            both.correct(np.array([0.1, -0.2]))
            alone[0].correct(0.1)
            alone[1].correct(-0.2)
        both.take(displacement_um)
        for at, each in enumerate(alone):
            each.take(np.ascontiguousarray(displacement_um[:, at]))
        assert both.stepped == any(each.stepped for each in alone)
        assert np.allclose(both.error_um, [each.error_um for each in alone], atol=1e-12)
    assert np.abs(both.voltage_v).max() > 0.5


def test_check_closes_the_loop_of_all_axes_at_each_row_of_gains():
    check_law(law_of(), SAMPLES)
    crossed = LinearBlock.of(np.eye(2), 8.0 * np.eye(2), [[0.0, 1.0], [1.0, 0.0]],
                             np.zeros((2, 2)), 2)
    with pytest.raises(FeedbackLawError, match=r"not stable .* gain of 0.2 and 0.3 um/V"):
        check_law(law_of(tick=crossed), SAMPLES)
    # Each axis alone is stable with this law.
    coupled = LinearBlock.of(LAG.a, LAG.b, [[0.1, 0.3], [0.3, 0.1]], LAG.d, 2)
    with pytest.raises(FeedbackLawError, match="not stable"):
        check_law(law_of(plant=DeclaredPlant(coupled, GAINS)), SAMPLES)


@pytest.mark.parametrize(("changes", "message"), [
    ({"sample": LinearBlock(d=0.1)}, "sample, or an inverse"),
    ({"observer": np.zeros(2)}, "observer of the law has"),
    ({"once_um": np.zeros((6, 3))}, "once_expected_um of the law has"),
    ({"plant": DeclaredPlant(LAG, GAINS[:, :1])}, "model_gains_um_per_v of the law has"),
    ({"axes": ()}, "for the axes"),
    ({"tick": LinearBlock.of([1.0], [1.0], [1.0], [0.0]), "observer": np.zeros((1, 2))},
     "tick of the law has")])
def test_parts_of_other_axes_are_refused(changes, message):
    with pytest.raises(FeedbackLawError, match=message):
        law_of(**changes)


def test_block_with_a_wrong_number_of_elements_is_refused():
    with pytest.raises(FeedbackLawError, match="a linear block of 2 axes has 4, 4, 2 and 4"):
        LinearBlock.of(np.eye(2), np.eye(2), np.ones(2), np.eye(2), 2)


@pytest.fixture
def designed():
    return AxesLaw(AXES, 25e-6, 40, INTEGRALS, OBSERVER, DeclaredPlant(LAG, GAINS),
                   np.array([10.0, 9.0]), {"order": 2}, {}, "0" * 64)


def test_law_file_gives_the_law_that_it_was_written_with(tmp_path, designed):
    path = tmp_path / "law.json"
    save_axes_law(path, designed)
    read = load_axes_law(path)
    for part in "abcd":
        assert np.array_equal(getattr(read.tick, part), getattr(designed.tick, part))
        assert np.array_equal(getattr(read.plant.linear, part), getattr(LAG, part))
    assert np.array_equal(read.plant.gains_um_per_v, GAINS)
    assert (read.axes, read.sample_period_s, read.samples_per_tick, read.report) == (
        AXES, 25e-6, 40, {"order": 2})
    law = read.following(np.zeros((3, 2)), np.ones((5, 2)), 3, 20.0)
    assert (law.axes, law.fade_samples, law.max_error_um) == (AXES, 800, 4.0)


@pytest.mark.parametrize(("name", "value", "message"), [
    ("B", [[1.0], [1.0]], "B is not a 2 x 2 matrix"),
    ("operating_displacement_um", [1.0], "has not 2 numbers"), ("version", 2, "version")])
def test_invalid_law_file_is_refused(tmp_path, designed, name, value, message):
    path = tmp_path / "law.json"
    save_axes_law(path, designed)
    document = json.loads(path.read_text()) | {name: value}
    path.write_text(json.dumps(document))
    with pytest.raises(LawFileError, match=message):
        load_axes_law(path)


def test_only_a_finite_law_is_written_and_only_over_a_law(tmp_path, designed):
    with pytest.raises(LawFileError, match="not finite"):
        save_axes_law(tmp_path / "law.json", replace(designed, observer=np.full((2, 2), np.nan)))
    other = tmp_path / "other.json"
    other.write_text("{}")
    with pytest.raises(LawFileError, match="is no law file"):
        save_axes_law(other, designed)
    with pytest.raises(LawFileError, match="cannot be written"):
        save_axes_law(tmp_path / "none" / "law.json", designed)
