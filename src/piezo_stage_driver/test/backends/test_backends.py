# SPDX-License-Identifier: BSD-3-Clause
"""A backend of another package is found by its entry point, as docs/adding_a_backend.md says."""

import sys

import numpy as np
import pytest

from piezo_stage_driver.backends.registry import BackendSettings, create_backend
from piezo_stage_driver.engine.stage_engine import StageEngine
from piezo_stage_driver.safety.limits import VoltageLimits

SETTINGS = BackendSettings("", 40000.0, 40, -20.0, 120.0, 0.0, 2000.0)


@pytest.fixture
def other_package(package_of_page, monkeypatch):
    """Return the package of the page, as if it were installed."""
    monkeypatch.syspath_prepend(package_of_page("adding_a_backend.md"))
    yield
    sys.modules.pop("my_lab_stage", None)


def test_backend_of_the_page_drives_a_stage(other_package):
    backend = create_backend("my_lab", SETTINGS)
    backend.open()
    engine = StageEngine(backend, VoltageLimits(-20.0, 120.0, 2.0e6))
    engine.commands.play(np.full(400, 10.0), 25e-6)
    blocks = []
    while not engine.idle:
        blocks.append(engine.advance())
    backend.close()
    assert max(block.voltage_v.max() for block in blocks) == 10.0
    assert np.isfinite(np.concatenate([block.displacement_um for block in blocks])).all()


def test_unknown_backend_is_refused_with_those_that_are_there(other_package):
    with pytest.raises(ValueError, match="no backend 'mine': .* my_lab or nidaqmx"):
        create_backend("mine", SETTINGS)


def test_backend_that_cannot_be_imported_is_refused_in_one_line(other_package, monkeypatch):
    monkeypatch.setitem(sys.modules, "my_lab_stage", None)
    with pytest.raises(ValueError, match="the backend 'my_lab' cannot be loaded: "):
        create_backend("my_lab", SETTINGS)
