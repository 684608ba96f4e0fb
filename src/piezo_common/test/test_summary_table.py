# SPDX-License-Identifier: BSD-3-Clause
"""A table is readable in a terminal, shown by a notebook, and numbers again in pandas."""

import re

import pytest

from piezo_common.summary_table import SummaryTable

TABLE = SummaryTable("A <title>", ("name", "value", "std. dev.", "unit"), [
    ("mode", 6283.18530, 0.0123, "rad/s"), ("gain", 0.123456789, None, "um/V"),
    ("fast", 62831.853, 123.4, "rad/s"), ("exact", 2.0, 0.0, "")], ("A note.",))


def columns(line):
    return re.split(r"\s{2,}", line.strip())


def test_a_value_has_the_digits_that_its_deviation_leaves():
    lines = repr(TABLE).splitlines()
    assert lines[0] == "A <title>" and lines[-1] == "A note."
    assert columns(lines[4]) == ["mode", "6283.185", "0.012", "rad/s"]
    assert columns(lines[5]) == ["gain", "0.12346", "um/V"]
    assert columns(lines[6]) == ["fast", "62832", "123", "rad/s"]
    assert columns(lines[7]) == ["exact", "2"]


def test_columns_are_aligned():
    lines = repr(TABLE).splitlines()
    ends = {match.end() for line in lines[2:4] for match in re.finditer("value|(?<= )-{5,}", line)}
    assert any(lines[4][:end].endswith("6283.185") for end in ends)


def test_html_is_escaped_and_holds_every_cell():
    html = TABLE._repr_html_()
    assert "A &lt;title&gt;" in html and html.count("<tr>") == 5
    assert re.search(r"<td[^>]*>6283.185</td>", html)


def test_frame_holds_numbers():
    pytest.importorskip("pandas")
    frame = TABLE.to_frame()
    assert frame["value"].tolist() == [6283.18530, 0.123456789, 62831.853, 2.0]
    assert frame["std. dev."].isna().tolist() == [False, True, False, False]
