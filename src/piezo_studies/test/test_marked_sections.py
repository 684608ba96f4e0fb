# SPDX-License-Identifier: BSD-3-Clause
"""Sections of a page: only what is between the marks changes, and nothing is left out silently."""

import pytest

from piezo_studies.marked_sections import with_sections

PAGE = "# Title\n<!-- rows of a -->\nold\n<!-- end -->\ntext\n<!-- rows of b -->\n<!-- end -->\n"


def test_only_the_sections_change():
    made = with_sections(PAGE, {"rows of b": "two\n", "rows of a": r"\1 one" + "\n"}, "rows of ")
    assert made == ("# Title\n<!-- rows of a -->\n\\1 one\n<!-- end -->\ntext\n"
                    "<!-- rows of b -->\ntwo\n<!-- end -->\n")
    assert with_sections(PAGE, {"rows of b": ""}) == PAGE


@pytest.mark.parametrize("page, sections, kind", [
    (PAGE, {"rows of a": ""}, "rows of "),
    (PAGE, {"rows of c": ""}, ""),
    (PAGE + PAGE, {"rows of a": "", "rows of b": ""}, "rows of "),
    ("no mark", {"rows of a": ""}, "rows of "),
])
def test_a_section_that_is_missing_or_one_too_many_is_said(page, sections, kind):
    with pytest.raises(ValueError, match="give it one for each of rows of"):
        with_sections(page, sections, kind)
