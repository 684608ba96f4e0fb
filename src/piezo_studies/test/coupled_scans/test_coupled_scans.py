# SPDX-License-Identifier: BSD-3-Clause
"""The tables of the study stand in its page, and the stage is played as the tables say."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from piezo_client.scans import StoredScan
from piezo_models.feedback_law.axes_law import AxesLaw
from piezo_models.feedback_law.feedback_law import DeclaredPlant, LinearBlock
from piezo_studies.coupled_scans import feedback_trials, xy_stage
from piezo_studies.coupled_scans.__main__ import SECTIONS, table
from piezo_studies.coupled_scans.feedback_trials import FeedbackRow, feedback_table
from piezo_studies.coupled_scans.trials import TABLES, Row
from piezo_studies.marked_sections import with_sections

PAGE = Path(__file__).parents[4] / "docs" / "several_axes.md"
ROW = Row("spiral", 49.0, 0.0721, 0.0282, 0.0281, 0.1, 5)


def test_page_has_a_table_of_every_trial():
    before = PAGE.read_text(encoding="utf-8")
    after = with_sections(before, {SECTIONS + name: table(name, [ROW]) for name in TABLES} | {
        SECTIONS + "feedback": feedback_table(iter(()))}, SECTIONS)
    assert after.count("| spiral | 49 | 0.072 | 0.028 | 5 | 0.028 | 0.1 |") == len(TABLES)
    for name in TABLES:
        assert table(name, []) in before, "run make coupled-scans"
    assert feedback_table(iter(())) in before, "run make coupled-scans"


def test_raster_is_followed_better_with_the_law_than_without():
    turn = 2.0 * np.pi * np.arange(40_000) / 40_000
    voltage_v = 50.0 + 20.0 * np.column_stack([np.cos(turn), np.sin(turn)])
    gains, one = np.array([0.3, 0.25]), np.eye(2)
    scan = StoredScan(("x", "y"), 1.0 / xy_stage.CLOCK_HZ, np.tile(voltage_v[:1], (400, 1)),
                      voltage_v, gains * voltage_v)
    law = AxesLaw(
        ("x", "y"), 1.0 / xy_stage.CLOCK_HZ, 40,
        LinearBlock(one, 0.05 * one, np.diag(1.0 / gains), 0.0 * one), np.diag(gains),
        DeclaredPlant(LinearBlock(0.5 * one, one, 0.5 * one, 0.0 * one), gains[None, :]),
        gains * 50.0, {}, {})
    without, led = (feedback_trials.followed_with_law(scan, law, 0.0, acts)
                    for acts in (False, True))
    assert np.all(led.error_percent < 0.3 * without.error_percent)
    assert np.all(np.abs(led.offset_um) < 0.01) and np.all(np.abs(without.offset_um) > 0.1)
    row = FeedbackRow("slow", "none", without, [led, led])
    assert feedback_table(iter([row])).count("| slow | none |") == 1


def test_mean_of_periods_has_less_noise():
    turn = 2.0 * np.pi * np.arange(400) / 400
    voltage_v = 50.0 + np.column_stack([np.cos(turn), 0.0 * turn])
    scan = StoredScan(("x", "y"), 1.0 / xy_stage.CLOCK_HZ, np.tile(voltage_v[:1], (400, 1)),
                      voltage_v, 0.3 * voltage_v)
    one, many = (xy_stage.followed(scan, 2, mean_of) for mean_of in (1, 16))
    assert np.ptp(one.displacement_um[:, 0]) == pytest.approx(
        np.ptp(many.displacement_um[:, 0]), rel=0.05)
    rough = [np.std(np.diff(run.displacement_um[:, 1])) for run in (one, many)]
    assert rough[1] == pytest.approx(rough[0] / 4.0, rel=0.3)


def test_recording_holds_the_periods_behind_those_that_settle(monkeypatch):
    made = xy_stage.axes_experiments("multisine", xy_stage.LIMITS)[:1]
    monkeypatch.setattr(xy_stage, "axes_experiments", lambda *_: [
        replace(each, voltage_v=each.voltage_v[:1600]) for each in made])
    recording, = xy_stage.recorded("multisine", 1)
    assert recording.periods == 2 and len(recording.voltage_v) == 3200
    assert np.array_equal(recording.voltage_v[:1600], recording.voltage_v[1600:])
