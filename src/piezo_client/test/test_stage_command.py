# SPDX-License-Identifier: BSD-3-Clause
from piezo_client import stage_command


def test_interrupt_before_the_work_is_read_ends_in_one_line(monkeypatch, capsys):
    def interrupted(name):
        raise KeyboardInterrupt

    monkeypatch.setattr(stage_command, "import_module", interrupted)
    assert stage_command.main(["list"]) == stage_command.INTERRUPTED == 130
    assert capsys.readouterr().err == "stage: interrupted; nothing had begun\n"
