# SPDX-License-Identifier: BSD-3-Clause
"""Libraries that are imported only when a file of their kind is read."""

from importlib import import_module
from pathlib import Path
from typing import Any

from piezo_common.extras import how_to_install
from piezo_recorder.reading.recording import RecordingError

PACKAGES = {"h5py": "h5py", "nptdms": "nptdms", "openpyxl": "openpyxl",
            "pyarrow.parquet": "pyarrow", "pyarrow.ipc": "pyarrow"}
"""Package to install for each module; all are in the extra ``formats`` of the suite."""


def library(module: str, path: Path) -> Any:
    """Import a library that reads a kind of file; RecordingError names a missing package."""
    try:
        return import_module(module)
    except ImportError:
        package = PACKAGES[module]
        raise RecordingError(f"{path} needs the package {package}, which is not installed: "
                             f"{how_to_install(package, 'formats')}, or save the data as "
                             "CSV") from None
