# SPDX-License-Identifier: BSD-3-Clause
"""The tables of the study stand in its page, and the stage is played as the tables say."""

from dataclasses import replace
from pathlib import Path

import control
import numpy as np
import pytest

from piezo_controller.axes.stored_scan import StoredScan
from piezo_models.axes.coupled import CoupledModel
from piezo_models.feedback_law.axes_law import AxesLaw
from piezo_models.feedback_law.feedback_law import DeclaredPlant, LinearBlock
from piezo_studies.coupled_scans import feedback_trials, xy_stage
from piezo_studies.coupled_scans.__main__ import SECTIONS, table
from piezo_studies.coupled_scans.feedback_trials import FeedbackRow, feedback_table
from piezo_studies.coupled_scans.images import image_table, images_figure, images_of_grating
from piezo_studies.coupled_scans.marks import MarkRow, mark_table
from piezo_studies.coupled_scans.scan_trials import TABLES, Row
from piezo_studies.marked_sections import with_sections

PAGE = Path(__file__).parents[4] / "docs" / "studies" / "several_axes.md"
ROW = Row("spiral", 49.0, 0.0721, 0.0282, 0.0281, 0.1, 5)


def test_page_has_a_table_of_every_trial():
    before = PAGE.read_text(encoding="utf-8")
    sections = {SECTIONS + name: table(name, [ROW]) for name in TABLES}
    after = with_sections(before, sections | {
        SECTIONS + "images": image_table({}, None),
        SECTIONS + "marks": mark_table(iter(())),
        SECTIONS + "feedback": feedback_table(iter(()))}, SECTIONS)
    assert image_table({}, None) in before, "run make coupled-scans"
    assert after.count("| spiral | 49 | 0.072 | 0.028 | 5 | 0.028 | 0.1 |") == len(TABLES)
    for name in TABLES:
        assert table(name, []) in before, "run make coupled-scans"
    for empty in feedback_table(iter(())), mark_table(iter(())):
        assert empty in before, "run make coupled-scans"


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


def test_row_of_marks_tells_the_mean_and_the_largest_lateness():
    row = MarkRow("slow", 3.14, np.array([3.0, -4.0]), np.array([0.5, -0.5]))
    assert mark_table(iter([row])).endswith("| slow | 3.1 | 3.5 | 4 | 0.5 | 0.5 |\n")


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


def test_images_of_the_grating_are_less_distorted_by_measured_positions():
    s, frequency = control.tf("s"), 2.0 * np.pi * np.array([307.4, 364.9])
    modes = [control.ss(gain * w**2 / (s**2 + 0.03 * w * s + w**2))
             for gain, w in zip((0.36, 0.29), frequency, strict=True)]
    model = replace(
        CoupledModel.from_control(
            control.sample_system(control.append(*modes), 1.0 / xy_stage.CLOCK_HZ), ("x", "y")),
        operating_voltage_v=np.array([50.0, 50.0]),
        operating_displacement_um=np.array([18.4, 14.3]))
    images, specimen = images_of_grating(model, 64, 100.0)
    rows = [row.split("|")[1:3] for row in image_table(images, specimen).splitlines()[2:]]
    assert [name.strip() for name, _ in rows] == list(images)
    by_commanded, by_measured = [float(seen) for _, seen in rows][::2], [
        float(seen) for _, seen in rows][1::2]
    assert min(by_commanded) > 5.0 * max(by_measured) and max(by_measured) < 0.1
    assert len(images_figure(images).axes) == 2
