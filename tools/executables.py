# SPDX-License-Identifier: BSD-3-Clause
"""List the packages and their executables, with what each does: `./run` without arguments.

python tools/executables.py
"""

import importlib
import re
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
HEAD = """\
./run PACKAGE EXECUTABLE [ARGS]     such as: ./run piezo_bringup suite
./run PACKAGE EXECUTABLE --help     tells the arguments of one
"""


def main():
    """Print the list."""
    print(HEAD)
    for package, executables in listed().items():
        print(package)
        for name, sentence in executables.items():
            print(f"  {name:16}{sentence}")
    return 0


def listed():
    """Sentences of the executables by name, by package; without those that have moved on."""
    found = {}
    for setup in sorted(ROOT.glob("src/*/setup.py")):
        points = re.findall(r'"(\w+) = ([\w.]+):main"', setup.read_text(encoding="utf-8"))
        if points:
            found[setup.parent.name] = {name: sentence(module) for name, module in sorted(points)}
    return found


def sentence(module):
    """What the executable of a module does, in a line."""
    module = importlib.import_module(module)
    if hasattr(module, "COMMAND"):
        return module.COMMAND.description
    if module.__name__.endswith(".node.start"):
        return module.main.__doc__
    text = " ".join(module.__doc__.split("\n\n")[0].split()).partition(": ")[2]
    return text[0].upper() + text[1:]


if __name__ == "__main__":
    sys.exit(main())
