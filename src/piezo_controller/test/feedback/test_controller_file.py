# SPDX-License-Identifier: BSD-3-Clause
import json
from dataclasses import replace

import numpy as np
import pytest

from piezo_controller.feedback.controller_file import (
    ControllerFileError,
    load_controller,
    load_stabilising_controller,
    save_controller,
)

TICK_S, CLOCK_PERIOD_S = 1e-3, 25e-6


@pytest.fixture
def document(controller, tmp_path):
    save_controller(tmp_path / "controller.json", controller)
    return json.loads((tmp_path / "controller.json").read_text())


def test_controller_comes_back_to_the_bit(controller, tmp_path):
    path = tmp_path / "controller.json"
    save_controller(path, controller)
    loaded = load_controller(path)
    for name in "ABCD":
        np.testing.assert_array_equal(getattr(loaded, name), getattr(controller, name))
    assert loaded.report == controller.report
    assert loaded.weights == controller.weights
    assert loaded.sample_period_s == controller.sample_period_s
    assert loaded.model_sha256 == "0" * 64
    assert [entry.name for entry in tmp_path.iterdir()] == ["controller.json"]


@pytest.mark.parametrize("change, message", [
    ({"format": "piezo_stage_model"}, "give a controller file"),
    ({"version": 2}, "version is 2, not 1"),
    ({"sample_period_s": 0}, "sample_period_s is out of range"),
    ({"report": []}, "report is not an object"),
    ({"model_sha256": None}, "model_sha256 is not a text"),
    ({"A": [[1.0, 2.0]]}, "A is not a 1 x 1 matrix"),
    ({"B": "x"}, "B is not a list"),
    ({"D": [[float("nan")]]}, r"D\[0\]\[0\] is not a finite number"),
    ({"extra": 1}, "extra is unknown"),
    ({"report": {"delay_ticks": 2}}, "delay_ticks of the report is not 0 or 1"),
    ({"report": {"delay_ticks": []}}, "delay_ticks of the report is not 0 or 1"),
    ({"report": {"hysteresis_gain_um_per_v": "x"}}, "hysteresis_gain_um_per_v of the report is no"),
])
def test_changed_file_is_refused_with_path_and_field(document, tmp_path, change, message):
    path = tmp_path / "changed.json"
    path.write_text(json.dumps({**document, **change}))
    with pytest.raises(ControllerFileError, match=message) as refusal:
        load_controller(path)
    assert str(refusal.value).startswith(str(path))
    assert "\n" not in str(refusal.value)


def test_missing_field_is_named(document, tmp_path):
    for name in document.keys() - {"format", "version"}:
        path = tmp_path / "short.json"
        path.write_text(json.dumps({k: v for k, v in document.items() if k != name}))
        with pytest.raises(ControllerFileError, match=f"{name} is missing"):
            load_controller(path)


def test_file_that_is_none_is_refused(tmp_path):
    with pytest.raises(ControllerFileError, match="cannot be read"):
        load_controller(tmp_path / "none.json")
    (tmp_path / "text.json").write_text("{")
    with pytest.raises(ControllerFileError, match="is not valid JSON"):
        load_controller(tmp_path / "text.json")


def test_controller_that_cannot_be_written_leaves_the_old_file(controller, tmp_path):
    path = tmp_path / "controller.json"
    save_controller(path, controller)
    before = path.read_text()
    with pytest.raises(ControllerFileError, match="not finite"):
        save_controller(path, replace(controller, D=np.array([[np.nan]])))
    assert path.read_text() == before
    with pytest.raises(ControllerFileError, match="cannot be written"):
        save_controller(tmp_path / "none" / "controller.json", controller)


def test_controller_that_stabilises_the_model_is_loaded_for_it(controller, stage_model, tmp_path):
    path = tmp_path / "controller.json"
    save_controller(path, controller)
    loaded = load_stabilising_controller(path, stage_model, TICK_S, CLOCK_PERIOD_S)
    np.testing.assert_array_equal(loaded.A, controller.A)


def test_controller_that_does_not_stabilise_the_model_is_refused(
        controller, stage_model, tmp_path):
    path = tmp_path / "controller.json"
    factor = 1.1 * controller.report["gain_margin_at_highest_gain"]
    save_controller(path, replace(controller, C=factor * controller.C, D=factor * controller.D))
    with pytest.raises(ControllerFileError, match=r"controller.json: .*does not stabilise"):
        load_stabilising_controller(path, stage_model, TICK_S, CLOCK_PERIOD_S)


def test_controller_for_another_tick_is_refused(controller, stage_model, tmp_path):
    path = tmp_path / "controller.json"
    save_controller(path, controller)
    with pytest.raises(ControllerFileError, match="sample_period_s is 0.001, .* 0.0005 s"):
        load_stabilising_controller(path, stage_model, TICK_S / 2, CLOCK_PERIOD_S)
