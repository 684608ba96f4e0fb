# SPDX-License-Identifier: BSD-3-Clause
import base64
import io
import re
from dataclasses import replace
from html import unescape

import numpy as np
import pytest
from matplotlib.image import imread

from piezo_identification.diagnosis.diagnose import diagnose
from piezo_identification.diagnosis.report import diagnosis_pictures as pictures
from piezo_identification.diagnosis.report.diagnosis_report import render_report
from piezo_identification.experiments import catalogue as experiments
from piezo_models.effects.vibration_mode import VibrationMode

MODE = VibrationMode(2.0 * np.pi * 1400.0, 0.03, 0.05)


@pytest.fixture(scope="module")
def diagnosis(plant, play):
    experiment = experiments.validation(arc_s=0.02, tones_s=0.2)
    return diagnose(plant, [play(experiment, 1, stage=replace(plant, effects=(MODE,)))])


@pytest.fixture(scope="module")
def page(diagnosis):
    return render_report(diagnosis, [("diagnosed", "today"), ("model", "<model>.json")])


def rows(page):
    """Return the texts of all table rows."""
    return [[unescape(text) for text in re.findall(r"<t[dh].*?>(.*?)</t[dh]>", row)]
            for row in re.findall(r"<tr>(.*?)</tr>", page)]


def test_the_verdict_is_the_heading_and_the_origin_follows_it(page):
    assert re.search(r"<h1>The model lacks vibration_mode: with it the error on held-out data "
                     r"falls from [\d.]+ to [\d.]+ nm RMS.</h1>", page)
    assert "<p>diagnosed: today</p>\n<p>model: &lt;model&gt;.json</p>" in page


def test_parameters_stand_with_their_uncertainty_and_the_error_before_and_after(page, diagnosis):
    found = diagnosis.effects[0]
    values = found["parameters"]["frequency_rad_per_s"], found["standard_deviations"][
        "frequency_rad_per_s"]
    assert [f"{values[0]:.5g}", f"{values[1]:.2g}"] in [row[2:4] for row in rows(page)]
    assert ["RMS (nm)", *(f"{1e3 * errors['rms_um']:.4g}" for errors in (
        diagnosis.before, diagnosis.after))] in rows(page)


def test_what_was_tried_says_what_became_of_every_candidate(page, diagnosis):
    tried = {attempt.name for attempt in diagnosis.selection.rounds[0]}
    outcomes = {row[0]: row[4] for row in rows(page) if len(row) == 5 and row[0] in tried}
    assert outcomes["vibration_mode"] == "added"
    assert set(outcomes) == tried
    known = re.compile("added|rejected: |nothing hints|in so short|here a model|cannot be told")
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


def test_the_page_is_self_contained_and_its_pictures_can_be_decoded(page):
    sources = re.findall(r'src="(.*?)"', page)
    assert len(sources) == 5
    for source in sources:
        pixels = imread(io.BytesIO(base64.b64decode(source.partition(",")[2])), format="png")
        assert np.ptp(pixels[..., :3]) > 0.5
    assert not re.search(r"https?:|url\(|@import|<script", page)


def test_the_pictures_can_be_read_in_grey_and_have_units(diagnosis, picture_faults):
    assert picture_faults(render_report, diagnosis) == []


def test_the_close_look_is_where_the_scatter_of_the_residual_fell_most(diagnosis):
    part = diagnosis.selection.regression.dataset.simulated[0]
    before_um, after_um = np.zeros(part.time_s.size), np.zeros(part.time_s.size)
    rings = slice(part.begin + 3 * pictures.CLOSE_SAMPLES, part.begin + 4 * pictures.CLOSE_SAMPLES)
    before_um[rings] = np.sin(np.arange(pictures.CLOSE_SAMPLES))
    before_um[: rings.start] = 5.0
    assert pictures._closest_look(part, before_um, after_um) == rings
