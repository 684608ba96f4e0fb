# SPDX-License-Identifier: BSD-3-Clause
"""The benchmarks' table: printed, and written as JSON."""

import json
from dataclasses import asdict, dataclass
from statistics import median

COLUMNS = "{:66}{:>12}{:>12}{:>12}  {}"


@dataclass
class Row:
    """One figure, measured once in every round.

    Attributes
    ----------
    name, unit : str
    values : list of float
        One of each round.
    at_least, at_most : float, optional
        What the median is to reach.
    """

    name: str
    unit: str
    values: list
    at_least: float | None = None
    at_most: float | None = None

    @property
    def median(self):
        """Of the rounds."""
        return median(self.values)

    @property
    def verdict(self):
        """Whether the median reaches what it is to; empty where that is not said."""
        if self.at_least is not None:
            return f"at least {self.at_least:g}: {_met(self.median >= self.at_least)}"
        if self.at_most is not None:
            return f"at most {self.at_most:g}: {_met(self.median <= self.at_most)}"
        return ""


def _met(yes):
    return "met" if yes else "MISSED"


def show(rows):
    """Print the rows."""
    print(COLUMNS.format("", "median", "lowest", "highest", "").rstrip())
    for row in rows:
        figures = [f"{value:.3g}" if value < 1000 else f"{value:,.0f}"
                   for value in (row.median, min(row.values), max(row.values))]
        name = f"{row.name} ({row.unit})" if row.unit else row.name
        print(COLUMNS.format(name, *figures, row.verdict).rstrip())


def write(rows, path):
    """Write the rows, with the medians, as JSON."""
    content = [{**asdict(row), "median": row.median} for row in rows]
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
