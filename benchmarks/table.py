# SPDX-License-Identifier: BSD-3-Clause
"""Print the table of the benchmarks, and write it as JSON."""

import json
from collections import defaultdict
from dataclasses import asdict, dataclass
from statistics import median

COLUMNS = "{:84}{:>12}{:>12}{:>12}  {}"


@dataclass
class Row:
    """One figure, measured once in every round."""

    name: str
    unit: str
    values: list
    """One of each round; none of what could not be measured."""
    at_least: float | None = None
    at_most: float | None = None
    """What the median is to reach."""
    remark: str = ""

    @property
    def median(self):
        """Of the rounds, None without any."""
        return median(self.values) if self.values else None

    @property
    def verdict(self):
        """Whether the median reaches what it is to; empty where that is not said."""
        if self.at_least is not None:
            return f"at least {self.at_least:g}: {_met(self.median >= self.at_least)}"
        if self.at_most is not None:
            return f"at most {self.at_most:g}: {_met(self.median <= self.at_most)}"
        return self.remark


class Measurements(defaultdict):
    """Values by (name, unit) of the row, and remarks by the name of the row."""

    def __init__(self):
        super().__init__(list)
        self.remarks = {}

    def table(self, targets=None):
        """Rows, with what their medians are to reach by name."""
        targets = targets or {}
        return [Row(name, unit, values, **targets.get(name, {}),
                    remark=self.remarks.get(name, "")) for (name, unit), values in self.items()]


def _met(yes):
    return "met" if yes else "MISSED"


def show(rows):
    """Print the rows."""
    print(COLUMNS.format("", "median", "lowest", "highest", "").rstrip())
    for row in rows:
        values = (row.median, min(row.values), max(row.values)) if row.values else "---"
        figures = [_figure(value) for value in values]
        name = f"{row.name} ({row.unit})" if row.unit else row.name
        print(COLUMNS.format(name, *figures, row.verdict).rstrip())


def _figure(value):
    if isinstance(value, str):
        return value
    return f"{value:.3g}" if value < 1000 else f"{value:,.0f}"


def write(rows, path):
    """Write the rows, with the medians, as JSON."""
    content = [{**asdict(row), "median": row.median} for row in rows]
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
