# SPDX-License-Identifier: BSD-3-Clause
"""Results of a run of hours; each is saved at once, so that the run can be resumed."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any


class KeptResults:
    """Results in a file, one JSON document a line, with what each is of and its conditions.

    Results of other conditions stay in the file and are ignored.
    """

    def __init__(self, path: Path, conditions: Mapping[str, Any] | None = None) -> None:
        self._path, self._conditions = path, dict(conditions or {})

    def results(self) -> dict[Any, Any]:
        """Return the saved results by what they are of: a number or a text."""
        if not self._path.exists():
            return {}
        lines = [json.loads(line) for line in self._path.read_text(encoding="utf-8").splitlines()]
        return {entry["of"]: entry["result"] for entry in lines
                if entry["conditions"] == self._conditions}

    def add(self, of: int | str, result: Any) -> None:
        """Save a result."""
        with self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(
                {"of": of, "conditions": self._conditions, "result": result}) + "\n")
