# SPDX-License-Identifier: BSD-3-Clause
"""What `suite` refuses before it starts anything."""

import pytest

from piezo_bringup.suite_command import BAD_INPUT, main


@pytest.mark.parametrize(("arguments", "said"), [
    (["--data-root", "none"], "none is no folder"),
    (["--parameters", "none.yaml"], "none.yaml is no file"),
])
def test_what_is_not_there_is_refused_in_one_line(tmp_path, monkeypatch, capsys, arguments, said):
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == BAD_INPUT
    told = capsys.readouterr().err
    assert said in told
    assert told.count("\n") == 1
    assert not [*tmp_path.iterdir()]
