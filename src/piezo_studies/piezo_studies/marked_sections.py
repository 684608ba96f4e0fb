# SPDX-License-Identifier: BSD-3-Clause
"""Replace sections of a page between two marks; the other text is unchanged."""

import re
from collections.abc import Mapping
from pathlib import Path


def with_sections(page: str, sections: Mapping[str, str], kind: str = "") -> str:
    """Return a page with its marked sections replaced.

    The texts end with a new line and are given by the names in the marks. A section is between the
    lines ``<!-- NAME -->`` and ``<!-- end -->``. All sections whose names begin with `kind` must be
    given; by default, only the given ones are replaced. ValueError is raised if a section is
    missing in the page, occurs twice, or is not given.
    """
    names = re.escape(kind) + "[^\n]+?" if kind else "|".join(map(re.escape, sections))
    marked = re.compile(rf"(<!-- ({names}) -->\n).*?(<!-- end -->)", re.S)
    found = [match[2] for match in marked.finditer(page)]
    if sorted(found) != sorted(sections):
        raise ValueError(f"the page has the sections {', '.join(found) or 'none'}; "
                         f"give it one for each of {', '.join(sections)}")
    return marked.sub(lambda match: match[1] + sections[match[2]] + match[3], page)


def write_sections(page: Path, sections: Mapping[str, str], kind: str = "") -> None:
    """Replace marked sections in the file of a page; see `with_sections`."""
    text = page.read_text(encoding="utf-8")
    page.write_text(with_sections(text, sections, kind), encoding="utf-8")
