# SPDX-License-Identifier: BSD-3-Clause
"""Gwyddion Simple Fields are read back as written, and refused in one line where incomplete."""

import numpy as np
import pytest

from piezo_common.gsf import MAGIC, Field, FieldError, read_gsf, write_gsf


@pytest.mark.parametrize(("unit", "title"), [("um", "grating"), ("", ""), ("V", "a"), ("V", "abc")])
def test_field_is_read_back_with_its_place_and_unit(tmp_path, unit, title):
    values = np.random.default_rng(1).normal(size=(3, 5))
    write_gsf(tmp_path / "map.gsf", Field(values, (-2.5, 1.0), (20.0, 12.0), unit, title))
    found = read_gsf(tmp_path / "map.gsf")
    np.testing.assert_allclose(found.values, values, rtol=1e-6)
    assert found.corner_um == pytest.approx((-2.5, 1.0))
    assert found.size_um == pytest.approx((20.0, 12.0))
    assert (found.unit, found.title) == (unit, title)


def test_header_is_that_of_the_format_and_numbers_begin_at_a_multiple_of_four(tmp_path):
    write_gsf(tmp_path / "map.gsf", Field(np.array([[1.0, 2.0]]), (0.0, 0.0), (2.0, 1.0), "um"))
    content = (tmp_path / "map.gsf").read_bytes()
    header, _, numbers = content.partition(b"\0")
    assert header.startswith(b"Gwyddion Simple Field 1.0\nXRes = 2\nYRes = 1\nXReal = 2e-06\n")
    assert len(content) % 4 == 0 and np.frombuffer(content[-8:], "<f4") == pytest.approx(
        [1e-6, 2e-6])
    assert 1 <= len(content) - 8 - len(header) <= 4 and set(numbers[:-8]) <= {0}


def test_place_is_that_of_the_middles_of_pixels():
    field = Field(np.zeros((4, 10)), (1.0, 2.0), (10.0, 8.0))
    assert field.pixels_at(np.array([[1.5, 3.0], [10.5, 9.0]])).tolist() == [[0.0, 3.0], [0.0, 9.0]]


@pytest.mark.parametrize(("content", "words"), [
    (MAGIC + b"XRes = 2\nYRes = 2\n" + bytes(16), "no complete Gwyddion Simple Field"),
    (MAGIC + b"XRes = 2\n", "no complete"), (b"P5 2 2 255\n", "no complete"),
    (b"XRes = 1\nYRes = 1\n" + bytes(20), "no area in metres"),
    (MAGIC + b"XRes = 1\nYRes = 1\nXYUnits = s\n" + bytes(20), "no area in metres"),
])
def test_other_files_are_refused(tmp_path, content, words):
    (tmp_path / "map.gsf").write_bytes(content)
    with pytest.raises(FieldError, match=words):
        read_gsf(tmp_path / "map.gsf")
    with pytest.raises(FieldError, match="a directory"):
        read_gsf(tmp_path)
