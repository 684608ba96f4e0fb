# SPDX-License-Identifier: BSD-3-Clause
"""Results of a run of hours; each is saved at once, so that the run can be resumed."""

import json


class KeptResults:
    """Results in a file, one JSON document a line, with the conditions of their run.

    Parameters
    ----------
    conditions : dict
        Conditions as plain values. Results of other conditions stay in the file and are ignored.
    """

    def __init__(self, path, conditions):
        self._path, self._conditions = path, conditions

    def results(self):
        """Return the saved results by number of their case."""
        if not self._path.exists():
            return {}
        lines = [json.loads(line) for line in self._path.read_text(encoding="utf-8").splitlines()]
        return {entry["result"]["number"]: entry["result"] for entry in lines
                if entry["conditions"] == self._conditions}

    def add(self, result):
        """Save the result of a case."""
        with self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps({"conditions": self._conditions, "result": result}) + "\n")
