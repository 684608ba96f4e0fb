# SPDX-License-Identifier: BSD-3-Clause
import json
from argparse import Namespace
from contextlib import nullcontext
from pathlib import Path
from unittest.mock import MagicMock

import pytest
from piezo_interfaces.msg import Reference

from piezo_client import stage_command, stage_work
from piezo_client.client import ServiceFailed
from piezo_client.results import Tracking


def test_interrupt_before_the_work_is_read_ends_in_one_line(monkeypatch, capsys):
    def interrupted(name):
        raise KeyboardInterrupt

    monkeypatch.setattr(stage_command, "import_module", interrupted)
    assert stage_command.main(["list"]) == stage_command.INTERRUPTED == 130
    assert capsys.readouterr().err == "stage: interrupted; nothing had begun\n"


@pytest.mark.parametrize("model, said", [
    (Path("/dev/zero"), ""),  # left to the nodes without being read to its end
    ("lacking.json", "the model is inadequate: the residual of creep is 3 times the noise\n"),
])
@pytest.mark.parametrize("command", ["track", "diagnose"])
def test_what_a_model_lacks_is_said_first(monkeypatch, tmp_path, capsys, command, model, said):
    part = {"ratio": 3.0, "verdict": "inadequate"}
    (tmp_path / "lacking.json").write_text(json.dumps({"adequacy": {"creep": part}}))
    monkeypatch.setattr(stage_work.signal, "signal", lambda *_: None)
    monkeypatch.setattr(stage_work, "Stage", lambda *_: nullcontext())
    monkeypatch.setitem(stage_work.WORK, command, lambda stage, options: ["done"])
    options = Namespace(command=command, model=tmp_path / model, namespace="", wait_s=1.0)
    assert stage_work.drive(options) == 0
    assert capsys.readouterr().out == f"{said}done\n"


@pytest.mark.parametrize("command, following", [
    ("list", "--namespace left status"), ("status", "identify --output <DIR>"),
    ("settle", "track --model <MODEL> --output <DIR>"), ("stop", "reset"), ("reset", "status")])
def test_command_without_results_names_the_one_that_follows(
        monkeypatch, capsys, command, following):
    monkeypatch.setattr(stage_work.signal, "signal", lambda *_: None)
    monkeypatch.setattr(stage_work, "Stage", lambda *_: nullcontext(MagicMock()))
    monkeypatch.setattr(stage_work, "stages_seen", lambda *_: {"/left": {"stage", "recorder"}})
    monkeypatch.setattr(stage_work, "status_lines", lambda *_: (["/stage is active"], False))
    options = Namespace(command=command, namespace="", wait_s=1.0)
    assert stage_work.drive(options) == 0
    *_, last = capsys.readouterr().out.splitlines()
    assert last == f"next: ./run piezo_client stage {following}"


def test_status_of_a_stopped_stage_names_the_reset(monkeypatch, capsys):
    monkeypatch.setattr(stage_work.signal, "signal", lambda *_: None)
    monkeypatch.setattr(stage_work, "Stage", lambda *_: nullcontext(MagicMock()))
    monkeypatch.setattr(stage_work, "status_lines", lambda *_: (["now: hung"], True))
    assert stage_work.drive(Namespace(command="status", namespace="", wait_s=1.0)) == 0
    *_, last = capsys.readouterr().out.splitlines()
    assert last == "next: ./run piezo_client stage reset"


def test_refusal_is_said_in_one_line(monkeypatch, capsys):
    def refused(stage, options):
        raise ServiceFailed("run_experiment: unknown experiment 'dance'")

    monkeypatch.setattr(stage_work.signal, "signal", lambda *_: None)
    monkeypatch.setattr(stage_work, "Stage", lambda *_: nullcontext())
    monkeypatch.setitem(stage_work.WORK, "experiment", refused)
    options = Namespace(command="experiment", namespace="", wait_s=1.0)
    assert stage_work.drive(options) == 1
    assert capsys.readouterr() == ("", "stage: run_experiment: unknown experiment 'dance'\n")


def test_a_namespace_that_cannot_be_is_refused_before_ros_is_asked(capsys):
    with pytest.raises(SystemExit) as ended:
        stage_command.main(["--namespace", "not ok", "status"])
    assert ended.value.code == 2
    assert "'not ok' is no namespace: give letters" in capsys.readouterr().err


@pytest.mark.parametrize("typed", [
    "track --model m.json --output runs --shape raster --lines -5",
    "play wave.csv --output runs --repeats 0", "scan plan --output runs --periods 0",
    "scan plan --output runs --learn -1",
    "diagnose --model m.json --data d.csv --output runs --experiments 1.5"])
def test_a_number_that_counts_nothing_is_refused_before_ros_is_asked(typed, capsys):
    with pytest.raises(SystemExit) as ended:
        stage_command.main(typed.split())
    assert ended.value.code == 2
    assert "is no count: give a whole number of 1 or more" in capsys.readouterr().err


def test_who_tracks_without_a_model_is_told_how_to_make_one(capsys):
    with pytest.raises(SystemExit):
        stage_command.main(["track", "--output", "runs"])
    printed = capsys.readouterr().err
    makes_one = "required: --model; identify makes a model: `./run piezo_client stage identify"
    assert makes_one in printed


@pytest.mark.parametrize(("given", "ignored"), [
    (["--file", "path.csv", "--frequency-hz", "20"], "path.csv does not depend on --frequency-hz"),
    (["--file", "path.csv", "--shape", "raster"], "path.csv does not depend on --shape"),
    (["--shape", "raster", "--centre-um", "5"], "raster does not depend on --centre-um"),
    (["--lines", "5"], "harmonic does not depend on --lines")])
def test_options_without_effect_on_a_reference_are_refused(
        monkeypatch, tmp_path, capsys, given, ignored):
    monkeypatch.chdir(tmp_path)
    for name in ("model.json", "path.csv"):
        Path(name).write_text("{}")
    monkeypatch.setattr(stage_work.signal, "signal", lambda *_: None)
    monkeypatch.setattr(stage_work, "Stage", lambda *_: nullcontext(MagicMock()))
    assert stage_command.main(["track", "--model", "model.json", "--output", "runs", *given]) == 2
    assert ignored in capsys.readouterr().err


def test_path_of_several_axes_is_tracked_by_its_shape(monkeypatch, tmp_path, capsys):
    model = tmp_path / "model.json"
    model.write_text(json.dumps({"format": "piezo_stage_model", "axes": ["x", "y"]}))
    stage = MagicMock()
    stage.track.return_value = Tracking(Path("run"), 0.2, 0.04, 0, "x: e_rms 0.2 %")
    monkeypatch.setattr(stage_work.signal, "signal", lambda *_: None)
    monkeypatch.setattr(stage_work, "Stage", lambda *_: nullcontext(stage))
    assert stage_command.main([
        "track", "--model", str(model), "--shape", "raster", "--frequency-hz", "20",
        "--amplitude-um", "5", "--lines", "10", "--output", "runs"]) == 0
    reference = Reference(**stage.track.call_args.args[0])
    assert (reference.kind, reference.frequency_hz.tolist(), reference.amplitude_um.tolist(),
            reference.lines, reference.centre_um) == ("raster", [20.0], [5.0], 10, 0.0)
    printed = capsys.readouterr().out
    assert "x: e_rms 0.2 %\n" in printed
    assert "next: ./run piezo_identification diagnose --model" in printed
