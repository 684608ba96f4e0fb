# SPDX-License-Identifier: BSD-3-Clause
"""Sections of a page that a program writes anew, between two marks, while the text around stays."""

import re
from collections.abc import Mapping


def with_sections(page: str, sections: Mapping[str, str], kind: str = "") -> str:
    """Return a page with its marked sections written anew.

    A section stands between the lines ``<!-- NAME -->`` and ``<!-- end -->``.

    Parameters
    ----------
    sections : mapping of str to str
        What each section holds, by the name in its mark; it ends with a new line.
    kind : str
        How the names begin of the sections that the program writes, all of which must be given.
        By default only those that are given are looked for.

    Raises
    ------
    ValueError
        If a section is missing in the page, stands there twice, or is not given.
    """
    names = re.escape(kind) + "[^\n]+?" if kind else "|".join(map(re.escape, sections))
    marked = re.compile(rf"(<!-- ({names}) -->\n).*?(<!-- end -->)", re.S)
    found = [match[2] for match in marked.finditer(page)]
    if sorted(found) != sorted(sections):
        raise ValueError(f"the page has the sections {', '.join(found) or 'none'}; "
                         f"give it one for each of {', '.join(sections)}")
    return marked.sub(lambda match: match[1] + sections[match[2]] + match[3], page)
