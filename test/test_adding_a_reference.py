# SPDX-License-Identifier: BSD-3-Clause
"""The reference of docs/adding_a_reference.md, installed from outside, is tracked."""

import os
import sys

import numpy as np
import pytest

from piezo_client.client import GoalFailed
from piezo_client.stage import Stage
from piezo_controller.references.reference import (
    InvalidReference,
    Reference,
    is_periodic,
    sample_reference,
    trajectory,
)
from piezo_models.identified_model import IdentifiedModel
from piezo_models.model_file import save_model
from piezo_recorder.reading.reader import read_recording

DWELLS = {"kind": "dwells", "frequency_hz": [20.0], "amplitude_um": [10.0], "centre_um": 40.0}
REFERENCE = Reference("dwells", (20.0,), (10.0,), centre_um=40.0)
RETURNED = "return reference.centre_um + amplitude_um * (up - down - 0.5)"


@pytest.fixture
def outside(package_of_page, monkeypatch):
    """The package of the page, installed for this process and for those it starts."""
    directory = package_of_page("adding_a_reference.md")
    monkeypatch.syspath_prepend(directory)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(directory), *sys.path]))
    yield directory
    sys.modules.pop("dwells", None)


def returning(directory, body):
    module = directory / "dwells.py"
    text = module.read_text()
    assert RETURNED in text
    module.write_text(text.replace(RETURNED, f"return {body}"))


def test_reference_from_outside_is_sampled_about_its_centre(outside):
    assert is_periodic(REFERENCE)
    period_um = sample_reference(REFERENCE)
    assert period_um.size == 2000
    assert (period_um.min(), period_um.max()) == pytest.approx((35.0, 45.0))
    assert np.count_nonzero(period_um == 35.0) > 500
    np.testing.assert_array_equal(trajectory(REFERENCE).sample(-100, 3100),
                                  period_um[np.arange(-100, 3000) % 2000])


def test_refusal_of_a_reference_from_outside_reaches_who_asks(outside):
    with pytest.raises(InvalidReference, match="a dwells reference has one frequency, not 2"):
        sample_reference(Reference("dwells", (20.0, 30.0), (1.0, 1.0)))


@pytest.mark.parametrize(("body", "message"), [
    ("np.full(10, np.nan)", "not one sequence of finite displacements"),
    ("np.zeros((5, 2))", "not one sequence of finite displacements"),
    ("np.zeros(1)", "a period of 1 samples"),
    ("np.zeros(900_000)", "a period of 900000 samples"),
])
def test_kind_that_returns_no_period_is_refused_in_one_sentence(outside, body, message):
    returning(outside, body)
    with pytest.raises(InvalidReference, match=message) as refusal:
        sample_reference(REFERENCE)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(("body", "message"), [
    ("np.full(10, np.nan)", "not one sequence of finite displacements"),
    ("np.zeros((5, 2))", "not one sequence of finite displacements"),
])
def test_trajectory_from_outside_that_is_not_finite_never_reaches_the_stage(outside, body, message):
    returning(outside, body)
    with pytest.raises(InvalidReference, match=message):
        trajectory(REFERENCE).sample(0, 4000)
    with pytest.raises(InvalidReference, match=message):
        trajectory(REFERENCE).survey(4000)


def test_kind_that_cannot_be_imported_is_refused_in_one_sentence(outside, monkeypatch):
    monkeypatch.setitem(sys.modules, "dwells", None)
    with pytest.raises(InvalidReference, match="the reference 'dwells' cannot be loaded"):
        sample_reference(REFERENCE)


def test_controller_tracks_the_reference_from_outside(outside, nodes, plain_model, tmp_path):
    model = tmp_path / "model.json"
    save_model(model, IdentifiedModel(plain_model, (-20.0, 120.0)))
    client = nodes.start("recorder", "controller")
    with pytest.raises(GoalFailed, match="use one of .*, file, dwells"):
        client.track({**DWELLS, "kind": "dwell"}, model, "feedforward", 0.2, tmp_path)
    with Stage() as stage:
        run = client.beside(stage.track, DWELLS, model, "feedforward", 0.2, tmp_path)
    assert run.e_rms_percent > 0.0
    recording = read_recording(run.path)
    assert recording.gaps == []
    # The model is another stage's: what remains is that the voltage waits on each of two levels.
    tracked_v = recording.voltage_v[recording.tracking][-2000:]
    period_um = sample_reference(REFERENCE)
    assert abs(np.corrcoef(np.abs(np.fft.rfft(tracked_v))[1:30],
                           np.abs(np.fft.rfft(period_um))[1:30])[0, 1]) > 0.99
