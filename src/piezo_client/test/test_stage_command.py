# SPDX-License-Identifier: BSD-3-Clause
from argparse import Namespace
from pathlib import Path
from types import SimpleNamespace

from piezo_client import stage_command
from piezo_client.stage_work import WORK


def test_interrupt_before_the_work_is_read_ends_in_one_line(monkeypatch, capsys):
    def interrupted(name):
        raise KeyboardInterrupt

    monkeypatch.setattr(stage_command, "import_module", interrupted)
    assert stage_command.main(["list"]) == stage_command.INTERRUPTED == 130
    assert capsys.readouterr().err == "stage: interrupted; nothing had begun\n"


def test_model_that_is_no_file_is_left_to_the_nodes_without_being_read():
    run = SimpleNamespace(e_rms_percent=0.1, largest_error_um=0.2, message="", path=Path("run"))
    options = Namespace(
        file=None, shape="harmonic", frequency_hz=100.0, amplitude_um=5.0, centre_um=50.0,
        model=Path("/dev/zero"), mode="composite", duration_s=1.0, output=Path("runs"),
        controller=None, namespace="")
    lines = WORK["track"](SimpleNamespace(track=lambda *_: run), options)
    assert lines[0] == "e_rms_percent 0.1"
