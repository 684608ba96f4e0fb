# SPDX-License-Identifier: BSD-3-Clause
import re
from dataclasses import replace
from html import unescape

import numpy as np
import pytest

from piezo_identification.diagnosis.diagnose import diagnose
from piezo_identification.diagnosis.report import diagnosis_pictures as pictures
from piezo_identification.diagnosis.report.diagnosis_report import _on_whiteness, render_report
from piezo_identification.experiments import catalogue as experiments
from piezo_identification.report.parameter_table import rounded
from piezo_models.effects.vibration_mode import VibrationMode

MODE = VibrationMode(2.0 * np.pi * 1400.0, 0.03, 0.05)


@pytest.fixture(scope="module")
def diagnosis(plant, play, few_effects):
    experiment = experiments.validation(arc_s=0.015, tones_s=0.06)
    with few_effects("thermal_drift", "backlash", "creep"):
        return diagnose(plant, [play(experiment, 1, stage=replace(plant, effects=(MODE,)))])


@pytest.fixture(scope="module")
def rendered(diagnosis, picture_faults):
    """Return the page, and what is wrong with its pictures."""
    pages = []
    faults = picture_faults(lambda: pages.append(render_report(
        diagnosis, [("diagnosed", "today"), ("model", "<model>.json")])))
    return pages[0], faults


@pytest.fixture(scope="module")
def page(rendered):
    return rendered[0]


def rows(page):
    """Return the texts of all table rows."""
    return [[unescape(text) for text in re.findall(r"<t[dh][^>]*>(.*?)</t[dh]>", row)]
            for row in re.findall(r"<tr>(.*?)</tr>", page)]


def test_the_verdict_is_the_heading_and_the_origin_follows_it(page):
    assert re.search(r"<h1>The model lacks vibration_mode: with it the error on held-out data "
                     r"falls from [\d.]+ to [\d.]+ nm RMS\.( The probability [^<]*)?</h1>", page)
    assert "<p>diagnosed: today</p>\n<p>model: &lt;model&gt;.json</p>" in page


def test_parameters_stand_with_their_uncertainty_and_the_error_before_and_after(page, diagnosis):
    found = diagnosis.effects[0]
    values = found["parameters"]["frequency_rad_per_s"], found["standard_deviations"][
        "frequency_rad_per_s"]
    row, = (row for row in rows(page) if row[1:2] == ["frequency_rad_per_s (rad/s)"])
    assert row[2:4] == list(rounded(*values))
    low, high = map(float, row[4].split(" to "))
    assert low < 2.0 * np.pi * 1400.0 < high
    assert float(row[5].split(" ± ")[0]) == pytest.approx(values[0] / (2.0 * np.pi), rel=1e-3)
    assert ["RMS (nm)", *(f"{1e3 * errors['rms_um']:.3g}" for errors in (
        diagnosis.before, diagnosis.after))] in rows(page)


def test_what_was_tried_says_what_became_of_every_candidate(page, diagnosis):
    tried = {attempt.name for attempt in diagnosis.selection.rounds[0]}
    outcomes = {row[0]: row[4] for row in rows(page) if len(row) == 5 and row[0] in tried}
    assert outcomes["vibration_mode"] == "added"
    assert set(outcomes) == tried
    known = re.compile("added|rejected: |no initial guess|in so short|here a model|cannot be dist")
    assert all(known.match(outcome) for outcome in outcomes.values())


def test_the_models_own_parameters_are_told_before_and_after(page, diagnosis, plant):
    now = diagnosis.model.dynamics.time_constant_s
    assert ["time_constant_s", "0.00049", f"{now:.5g}",
            f"{100.0 * (now / plant.dynamics.time_constant_s - 1.0):+.2f}"] in rows(page)


def test_what_could_not_be_decided_names_the_experiment_that_would(page, diagnosis):
    assert "thermal_drift" in diagnosis.not_decidable
    undecided = next(row for row in rows(page) if row[0] == "thermal_drift" and len(row) == 3)
    assert undecided[1:] == [diagnosis.not_decidable["thermal_drift"],
                             "rest for minutes, and the same waveform repeated at later times"]


def test_the_page_is_self_contained_and_its_pictures_can_be_decoded(page, page_parts):
    parts = page_parts(page)
    assert len(parts.pictures) == 6
    assert all(parts.is_picture(name) for name in parts.pictures)
    assert parts.external == []
    assert "<link" not in page and not re.search("<script[^>]+src=", page)


def test_no_error_is_drawn_where_the_stage_does_not_move(page, page_parts):
    error = page_parts(page).numbers("Error over frequency")
    told = [value for head, values in error.items() if "displacement (%)" in head
            for value in values if np.isfinite(value)]
    assert told and max(told) <= 1000.0


def test_what_is_not_white_is_explained_where_it_stands(diagnosis, page):
    part = diagnosis.selection.regression.dataset.simulated[0]
    random = np.random.default_rng(6).normal(size=(2, part.time_s.size))
    white_um, drifting_um = 0.01 * random[0], 0.01 * random[0] + 1e-4 * np.cumsum(random[1])
    white, drifting = (pictures.Residuals(part, white_um, after_um, 0.01)
                       for after_um in (white_um, drifting_um))
    assert len(_on_whiteness(diagnosis, white)) == 1
    told = _on_whiteness(diagnosis, drifting)[1]
    assert "no contradiction to the verdict" in told and "a noise of 10 nm" in told
    unexplained = replace(diagnosis, verdict="unexplained")
    assert len(_on_whiteness(unexplained, drifting)) == 1
    assert "about 1 % of the lags" in page


@pytest.mark.usefixtures("without_pictures")
def test_probabilities_stand_in_the_verdict_and_in_a_table(diagnosis, page_parts):
    known = {"vibration_mode": 0.93, "none": 0.0201, "creep+delay": 0.0499 - 1e-5,
             "something_else": 1e-5}
    object.__setattr__(told := replace(diagnosis), "probabilities", known)
    page = page_parts(render_report(told))
    assert page.title.endswith("The probability of this is 93 %.")
    table, = (table for table in page.tables if table[0][1] == "probability (%)")
    assert table[1:] == [["vibration_mode", "93"], ["creep and delay", "4.99"],
                         ["nothing", "2.01"]]
    assert "1 more has less than 0.1 %" in page.text


def test_the_pictures_can_be_read_in_grey_and_have_units(rendered):
    assert rendered[1] == []


def test_the_close_look_is_where_the_scatter_of_the_residual_fell_most(diagnosis):
    part = diagnosis.selection.regression.dataset.simulated[0]
    before_um, after_um = np.zeros(part.time_s.size), np.zeros(part.time_s.size)
    rings = slice(part.begin + 3 * pictures.CLOSE_SAMPLES, part.begin + 4 * pictures.CLOSE_SAMPLES)
    before_um[rings] = np.sin(np.arange(pictures.CLOSE_SAMPLES))
    before_um[: rings.start] = 5.0
    assert pictures._closest_look(
        pictures.Residuals(part, before_um, after_um, 0.01)) == rings
