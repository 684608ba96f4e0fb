# SPDX-License-Identifier: BSD-3-Clause
import pytest

from piezo_common.progress_part import part_of


def test_parts_of_parts_tell_how_much_of_the_whole_is_done():
    told = []
    half = part_of(lambda what, fraction: told.append((what, fraction)), 0.5, 1.0)
    half("first", 0.0)
    part_of(half, 0.2, 0.6)("second", 0.5)
    half("third", 1.0)
    assert [what for what, _ in told] == ["first", "second", "third"]
    assert [fraction for _, fraction in told] == pytest.approx([0.5, 0.7, 1.0])


def test_nobody_needs_to_listen():
    part_of(None, 0.0, 1.0)("work", 0.5)
