# SPDX-License-Identifier: BSD-3-Clause
"""Only regular files of a bounded size are read, and a slow read can be given up."""

import os

import pytest

from piezo_common.cancellation import checking
from piezo_common.regular_file import UnreadableFile, open_regular
from piezo_common.text_file import PART_BYTES, read_bounded_text


@pytest.fixture
def path(tmp_path):
    return tmp_path / "file"


def test_what_is_no_regular_file_is_refused_without_waiting(path):
    os.mkfifo(path)
    for name, reason in ((path, "is a pipe"), ("/dev/zero", "is a device"),
                         (path.parent, "is a directory")):
        with pytest.raises(UnreadableFile, match=f"{reason}, not a regular file"):
            open_regular(name, 10)


def test_larger_files_are_refused_whatever_they_say_of_their_size(path):
    path.write_bytes(bytes(11))
    with pytest.raises(UnreadableFile, match="has 11 bytes, more than the 10"):
        open_regular(path, 10)
    assert os.stat("/proc/self/maps").st_size == 0
    with pytest.raises(UnreadableFile, match="more than the 10 bytes"):
        read_bounded_text("/proc/self/maps", 10)


def test_read_is_given_up_between_two_parts(path):
    path.write_bytes(b" " * (3 * PART_BYTES))
    parts = []

    def check():
        parts.append(1)
        if len(parts) == 2:
            raise InterruptedReading

    with pytest.raises(InterruptedReading), checking(check):
        read_bounded_text(path)


def test_text_is_read_as_any_text_file(path):
    path.write_bytes("a\r\nµ\n".encode())
    assert read_bounded_text(path) == "a\nµ\n"
    path.write_bytes(b"\xff")
    with pytest.raises(UnreadableFile, match="is not text"):
        read_bounded_text(path)


class InterruptedReading(Exception):
    """The reading was given up."""
