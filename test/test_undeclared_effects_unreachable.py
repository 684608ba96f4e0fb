# SPDX-License-Identifier: BSD-3-Clause
"""No path leads from identification and control to the effects that the simulated stage hides."""

from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[1] / "src"
BLIND = ["piezo_models", "piezo_identification", "piezo_controller", "piezo_recorder"]


@pytest.mark.parametrize("package", BLIND)
def test_no_file_of_the_package_names_the_simulator(package):
    files = [
        path
        for folder in (package, "test", "config")
        for path in (SOURCE / package / folder).rglob("*")
        if path.suffix in {".py", ".yaml", ".json"}
    ]
    assert files
    naming = [path for path in files if "piezo_sim" in path.read_text(encoding="utf-8")]
    assert naming == []
