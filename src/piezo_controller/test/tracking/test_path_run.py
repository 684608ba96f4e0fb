# SPDX-License-Identifier: BSD-3-Clause
"""A goal to track a path with several axes is planned as a scan and measured axis by axis."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
import two_axis_flexure

from piezo_controller.axes.followed_scan import AxesStage
from piezo_controller.axes.scan import scan
from piezo_controller.axes.stored_scan import PERIOD_FILE, stored_scan, write_scan
from piezo_controller.feedback import feedback_design
from piezo_controller.references.reference import Reference
from piezo_controller.tracking.feedbacks import Feedbacks, FeedbackSettings
from piezo_controller.tracking.path_run import prepare_path
from piezo_controller.tracking.track import Steps, TrackRequest
from piezo_controller.tracking.tracking_modes import StageClock
from piezo_models import save_axes_model

CLOCK = StageClock((-120.0, 120.0))
STAGE = AxesStage(("x", "y"), two_axis_flexure.PERIOD_S, 40, np.array([[-120.0, 120.0]] * 2),
                  np.zeros(2), np.full(2, 2000.0))
RASTER = Reference("raster", (100.0,), (10.0,), lines=6)


@pytest.fixture(scope="module")
def model_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("model") / "model.json"
    save_axes_model(path, two_axis_flexure.identified(120.0))
    return path


@pytest.fixture
def prepared(model_file):
    def prepare(mode, reference=RASTER, duration_s=0.2, stage=STAGE, settings=None, **changes):
        request = TrackRequest(mode, str(model_file), "0" * 64, [reference], [duration_s])
        return prepare_path(replace(request, **changes), CLOCK, stage,
                            Feedbacks(settings or FeedbackSettings(), CLOCK), Steps())

    return prepare


def played(prepared):
    """Play a run on the flexure, a tick after the other."""
    plan, ticks = prepared.plan, prepared.ticks(40)
    at = np.arange(40 * ticks - len(plan.once_voltage_v)) % len(plan.period_voltage_v)
    voltage_v = np.concatenate([plan.once_voltage_v, plan.period_voltage_v[at]])
    found_um = two_axis_flexure.played_um(voltage_v)
    for block_um in np.split(found_um, ticks):
        assert not prepared.run.complete
        assert prepared.take(block_um.ravel()) == 0.0
    assert prepared.run.complete and prepared.run.fraction == 1.0
    return prepared.run, found_um


def test_path_is_followed_as_far_as_its_inverse_and_measured_axis_by_axis(prepared):
    ready = prepared("feedforward")
    assert ready.run.note == ""
    exact, found_um = played(ready)
    plain, _ = played(prepared("open_loop"))
    assert exact.e_rms_percent() < 0.1 and exact.on_target and exact.settled_after_sample == 0
    assert plain.e_rms_percent() > 10.0 and not plain.on_target
    assert np.isnan(plain.settled_after_sample)
    for run in exact, plain:
        axes, percent = zip(*re.findall(r"(\w): e_rms (\S+) %, largest error", run.note),
                            strict=True)
        assert axes == ("x", "y")
        assert max(map(float, percent)) == pytest.approx(run.e_rms_percent(), rel=1e-3)
    assert "did not follow" in plain.note and "did not follow" not in exact.note
    assert np.ptp(found_um[-8000:], axis=0) == pytest.approx([10.0 * 4 / 3, 10.0], rel=0.3)


def test_path_planned_before_is_tracked_from_its_file(prepared, model_file, tmp_path):
    plan = scan(str(model_file), "spiral", size_um=(5.0, 5.0), rate_hz=100.0, lines=4)
    write_scan(stored_scan(plan), tmp_path)
    run = prepared("feedforward", Reference("file", file=str(tmp_path / PERIOD_FILE)))
    assert np.allclose(np.roll(run.plan.period_voltage_v, 4000, axis=0), plan.voltage_v, atol=1e-4)
    followed, _ = played(run)
    assert followed.e_rms_percent() < 0.1


@pytest.mark.usefixtures("short_search")
def test_marks_come_with_their_places_from_the_first_period_on(
        prepared, model_file, monkeypatch):
    monkeypatch.setattr(feedback_design, "FREQUENCIES", 10)
    run = prepared("composite")
    once, period = (np.frombuffer(part, np.uint8) for part in run.marks)
    assert len(once) == len(run.plan.once_voltage_v) and len(period) == 2720
    plan = scan(str(model_file), "raster", size_um=(10.0, 10.0), rate_hz=100.0, lines=6)
    assert np.array_equal(np.roll(period, 4000), plan.marks)
    start = run.plan.feedback_start_sample
    assert not once[:start].any()
    assert np.array_equal(once[start:], np.concatenate([plan.marks, plan.marks])[:4000])
    assert json.loads(run.attachments["scan.json"])["pixels"] == [6, 6]
    assert run.law.start_sample == start


def test_axis_that_rests_is_measured_by_the_travel_of_the_other(prepared):
    run, _ = played(prepared("feedforward", Reference("lissajous", (50.0,), (10.0, 0.0), lines=2)))
    assert run.e_rms_percent() < 0.1


def test_errors_of_a_run_within_a_line_are_relative_to_the_travel_of_the_path(prepared):
    run, _ = played(prepared("feedforward", duration_s=0.002))
    assert run.e_rms_percent() < 0.2


@pytest.mark.parametrize(("changes", "said"), [
    ({"mode": "learning"}, "do not track in the mode 'learning': use one of open_loop"),
    ({"mode": "pid"}, "do not track in the mode 'pid'"),
    ({"references": [RASTER, RASTER]}, "repeat one path by its exact inverse: leave then"),
    ({"inversion": "zero_phase"}, "repeat one path by its exact inverse: leave then"),
    ({"references": [replace(RASTER, kind="harmonic", centre_um=50.0)]},
     "several axes follow no 'harmonic': use one of raster"),
    ({"references": [replace(RASTER, kind="points")]}, "the kind points needs a file: name it"),
    ({"references": [replace(RASTER, file="path.csv")]}, "the kind raster takes no file"),
    ({"references": [replace(RASTER, centre_um=5.0)]}, "leave centre_um, phase_rad and once out"),
    ({"references": [replace(RASTER, amplitude_um=(1.0,) * 3)]}, "the path has 1 rates and 3"),
    ({"references": [replace(RASTER, amplitude_um=(90.0,))]}, "within reach are"),
    ({"stage": replace(STAGE, voltage_range_v=np.array([[-120.0, 120.0], [-5.0, 5.0]]))},
     "y voltages from .* available are -5 to 5 V"),
    ({"stage": replace(STAGE, axes=("y", "x"))}, "the model has the axes x, y at 40000 Hz, the s"),
    ({"mode": "composite", "settings": FeedbackSettings(loop="remote")}, "set feedback to onboard"),
])
def test_what_several_axes_do_not_track_is_refused_with_what_to_change(prepared, changes, said):
    with pytest.raises(ValueError, match=said):
        prepared(**{"mode": "feedforward", **changes})
