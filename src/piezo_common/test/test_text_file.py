# SPDX-License-Identifier: BSD-3-Clause
"""A JSON file replaces only one of its own format, and only with values that can be read again."""

import json

import pytest

from piezo_common import text_file
from piezo_common.text_file import replace_document


class ThisFileError(ValueError):
    """Error of the file under test."""


def replace(path, value):
    replace_document(path, {"format": "this", "value": value}, "file of this", ThisFileError)


def test_a_file_of_the_same_format_is_replaced_and_kept(tmp_path, caplog):
    path, previous = tmp_path / "file.json", tmp_path / "file.previous.json"
    replace(path, 1.0)
    assert not caplog.messages
    replace(path, 2.0)
    assert caplog.messages == [f"{path}: the earlier file is kept as file.previous.json"]
    assert json.loads(path.read_text())["value"] == 2.0
    assert json.loads(previous.read_text())["value"] == 1.0
    assert set(tmp_path.iterdir()) == {path, previous}


def test_an_interrupt_never_loses_the_earlier_file(tmp_path, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    replace(tmp_path / "file.json", 1.0)
    monkeypatch.setattr(text_file, "keep_previous", interrupted)
    with pytest.raises(KeyboardInterrupt):
        replace(tmp_path / "file.json", 2.0)
    kept, = tmp_path.iterdir()
    assert json.loads(kept.read_text())["value"] == 1.0


def test_a_file_that_does_not_change_is_not_kept_twice(tmp_path, caplog):
    replace(tmp_path / "file.json", 1.0)
    replace(tmp_path / "file.json", 1.0)
    assert not caplog.messages
    assert list(tmp_path.iterdir()) == [tmp_path / "file.json"]


@pytest.mark.parametrize("content", ['{"format": "that"}', "time_s,voltage_v\n0,1\n", "[1]"])
def test_any_other_file_is_kept(tmp_path, content):
    path = tmp_path / "file.json"
    path.write_text(content)
    with pytest.raises(ThisFileError, match="is no file of this, so it is not overwritten"):
        replace(path, 1.0)
    assert path.read_text() == content


def test_a_failure_keeps_the_file_and_names_the_cause(tmp_path):
    path = tmp_path / "file.json"
    replace(path, 1.0)
    with pytest.raises(ThisFileError, match="not finite"):
        replace(path, float("nan"))
    assert json.loads(path.read_text())["value"] == 1.0
    with pytest.raises(ThisFileError, match="cannot be written .*exists and is writable"):
        replace(tmp_path / "absent" / "file.json", 1.0)
