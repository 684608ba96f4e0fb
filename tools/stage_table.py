# SPDX-License-Identifier: BSD-3-Clause
"""Write docs/stage_states.md: the states of the stage, from the table that its supervisor goes by.

python tools/stage_table.py [--check]
"""

import sys

from generated_page import ROOT, write_or_check

PAGE = ROOT / "docs" / "stage_states.md"
sys.path.insert(0, str(ROOT / "src" / "piezo_stage_driver"))

from piezo_stage_driver.safety.transitions import (  # noqa: E402
    FAULTS,
    STATES,
    TRANSITIONS,
)

HEAD = """\
# States of the stage

Written by `make docs` from `piezo_stage_driver/safety/transitions.py`, the table by which the
supervisor of the stage goes; do not edit. An event that a state does not have is refused, with
the cause. `emergency_stop` is taken in every state. A stop acts in the next tick, whatever waits;
what was asked before it and has not acted yet never acts.

"""


def main(arguments: list[str] | None = None) -> int:
    """Write the page, or with ``--check`` only say whether it is up to date."""
    return write_or_check(PAGE, page, __doc__, arguments)


def page() -> str:
    """Return the page."""
    return HEAD + "\n".join([
        "## States\n\n" + table(
            ("state", "what it means", "who may command"),
            ((f"`{state}`", *told) for state, told in STATES.items())),
        "## Transitions\n\n" + table(
            ("state", "event", "next state", "what the backend is asked to do"),
            ((f"`{state}`", str(event), f"`{to.to}`", to.backend)
             for state in STATES for (origin, event), to in TRANSITIONS.items()
             if origin is state)),
        "## What each fault leads to\n\n" + table(("fault", "what follows"), FAULTS)])


def table(head, rows):
    """Return a table in Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return "".join("| " + " | ".join(cells) + " |\n" for cells in lines)


if __name__ == "__main__":
    sys.exit(main())
