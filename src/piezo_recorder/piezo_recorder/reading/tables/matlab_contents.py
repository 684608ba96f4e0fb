# SPDX-License-Identifier: BSD-3-Clause
"""Write the numeric arrays of a MATLAB file as .npz: a program that `matlab_files` starts.

It runs in a separate process, because SciPy's reader crashes on some damaged files, and takes all
time and memory on others. It imports nothing of this package, so that it starts quickly.
"""

import json
import resource
import sys
import warnings
from collections.abc import Iterator
from typing import Any

import numpy as np
from scipy.io import loadmat


def numeric_arrays(name: str, value: Any) -> Iterator[tuple[str, np.ndarray]]:
    """Yield names and numeric arrays of a variable; those of structures are named NAME.FIELD.

    The value is a result of `scipy.io.loadmat`, squeezed, with structures as objects. An array of
    structures yields NAME.NUMBER.FIELD, or NAME.FIELD if each field is one number.
    """
    fields = getattr(value, "_fieldnames", None)
    if fields is not None:
        if is_capture(value):
            yield from _of_capture(name, value)
            return
        for field in fields:
            yield from numeric_arrays(f"{name}.{field}", getattr(value, field))
    elif isinstance(value, np.ndarray) and value.dtype == object:
        if value.size and all(hasattr(each, "_fieldnames") for each in value.flat):
            yield from _of_structures(name, list(value.flat))
    elif np.asarray(value).dtype.kind in "iufb":
        yield name, np.asarray(value)


def _of_structures(name: str, structures: list[Any]) -> Iterator[tuple[str, np.ndarray]]:
    numbered = [dict(numeric_arrays(str(number), each))
                for number, each in enumerate(structures, start=1)]
    for field in structures[0]._fieldnames:
        samples = [arrays.get(f"{number}.{field}") for number, arrays in enumerate(numbered, 1)]
        if len(samples) > 1 and all(each is not None and each.size == 1 for each in samples):
            yield f"{name}.{field}", np.array([float(each.item()) for each in samples])  # type: ignore[union-attr]
            for number, arrays in enumerate(numbered, start=1):
                del arrays[f"{number}.{field}"]
    for arrays in numbered:
        for label, values in arrays.items():
            yield f"{name}.{label}", values


def is_capture(structure: Any) -> bool:
    """Return whether a structure is a capture of dSPACE ControlDesk with time X and signals Y."""
    if not {"X", "Y"} <= set(structure._fieldnames):
        return False
    signals = np.atleast_1d(structure.Y)
    return "Data" in getattr(structure.X, "_fieldnames", ()) and all(
        {"Name", "Data"} <= set(getattr(each, "_fieldnames", ())) for each in signals)


def _of_capture(name: str, capture: Any) -> Iterator[tuple[str, np.ndarray]]:
    yield f"{name}.time [s]", np.asarray(capture.X.Data)
    signals = np.atleast_1d(capture.Y)
    for signal, label in zip(signals, distinct_labels([str(each.Name) for each in signals]),
                             strict=True):
        unit = getattr(signal, "Unit", "")
        unit = f" [{unit}]" if isinstance(unit, str) and unit.strip() else ""
        yield f"{name}.{label}{unit}", np.asarray(signal.Data)


def distinct_labels(paths: list[str]) -> list[str]:
    """Return the distinguishing words of block paths, without their common beginning and end.

    A path is such as ``"Model Root"/"Sensor"/"In1"``.
    """
    words = [[_printable(word) for word in path.strip('"').split('"/"')] for path in paths]
    if len(words) == 1:
        return ["/".join(words[0])]
    for end in (0, -1):
        while all(len(each) > 1 for each in words) and len({each[end] for each in words}) == 1:
            for each in words:
                del each[end]
    return ["/".join(each) for each in words]


def _printable(word: str) -> str:
    """Return a word without points, which separate groups from names, and unprintable letters."""
    return "".join(letter if letter.isprintable() and letter != "." else "_" for letter in word)


def main(path: str, target: str, most_bytes: str) -> None:
    """Write the arrays to a file, and print the names of all variables and of these arrays."""
    resource.setrlimit(resource.RLIMIT_AS, (int(most_bytes), int(most_bytes)))
    warnings.simplefilter("ignore")
    variables = {name: value for name, value in loadmat(
        path, squeeze_me=True, struct_as_record=False).items() if not name.startswith("__")}
    arrays = dict(pair for name, value in variables.items() for pair in numeric_arrays(name, value))
    np.savez(target, *arrays.values())
    print(json.dumps([list(variables), list(arrays)]))


if __name__ == "__main__":
    try:
        main(*sys.argv[1:])
    except Exception as error:
        sys.exit(str(error) or type(error).__name__)
