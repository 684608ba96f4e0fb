# SPDX-License-Identifier: BSD-3-Clause
"""The table that compares the thesis' figures with ours, as text, JSON and Markdown."""

import json
from dataclasses import asdict, dataclass, field

from piezo_studies.tables import markdown_table, text_table


@dataclass(frozen=True)
class Row:
    """One figure of the thesis, and ours."""

    section: str
    """Section of the thesis."""
    quantity: str

    thesis: float | None
    """Figure of the thesis; None if it gives none."""
    ours: float

    unit: str
    """Unit; "1" for plain numbers."""
    remark: str = ""
    """Reason for a difference, or explanation of our figure."""
    below: bool = False
    """Whether the thesis says "less than"."""

    def __post_init__(self):
        # NumPy's integers cannot be written as JSON.
        object.__setattr__(self, "ours", float(self.ours))

    def cells(self):
        """Return the cells as text: section, quantity, thesis, ours, unit, remark."""
        thesis = "-" if self.thesis is None else _digits(self.thesis)
        thesis = f"< {thesis}" if self.below else thesis
        unit = "" if self.unit == "1" else self.unit
        return self.section, self.quantity, thesis, _digits(self.ours), unit, self.remark


@dataclass(frozen=True)
class Study:
    """The results of a study."""

    rows: list

    pictures: dict = field(default_factory=dict)
    """Figures by number of the corresponding figure in the thesis, such as "2.2"."""


HEADER = ("section", "quantity", "thesis", "ours", "unit", "remark")


def as_text(rows):
    """Return the table as text with aligned columns."""
    return text_table([HEADER, *(row.cells() for row in rows)])


def as_markdown(rows):
    """Return the table as Markdown, ending with a new line."""
    return markdown_table(HEADER, [row.cells() for row in rows], ("thesis", "ours"))


def as_json(rows):
    """Return the table as JSON: a list of rows."""
    return json.dumps([asdict(row) for row in rows], indent=1, allow_nan=False) + "\n"


def _digits(value):
    """Return a value with four significant digits; integers are written in full."""
    if float(value).is_integer() and abs(value) < 1e6:
        return f"{value:.0f}"
    return f"{value:.4g}"
