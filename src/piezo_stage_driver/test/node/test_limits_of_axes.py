# SPDX-License-Identifier: BSD-3-Clause
"""The parameters of a stage node that limit a single axis."""

from types import SimpleNamespace

import pytest

from piezo_stage_driver.node.stage_settings import StageSettings
from piezo_stage_driver.safety.guards import StopLatch


def node(**given):
    """Return a node with these parameters, and the default values of all others."""
    return SimpleNamespace(
        _parameter_overrides=given, has_parameter=lambda name: False,
        declare_parameter=lambda name, value, descriptor: SimpleNamespace(
            value=given.get(name, value)))


def supervisor(axes, **given):
    backend = SimpleNamespace(sample_rate_hz=40_000.0, axes=axes)
    return StageSettings(node(**given)).create_supervisor(backend, StopLatch())


@pytest.mark.parametrize(("axes", "found"), [
    ((), "one axis without a name"), (("x", "z"), "x, z")])
def test_limit_of_an_axis_that_the_backend_lacks_is_refused_with_its_name(axes, found):
    with pytest.raises(ValueError, match=(
            "parameter y.maximum_voltage_v is of an axis that the backend does not have, which has "
            f"{found}: correct")):
        supervisor(axes, **{"y.maximum_voltage_v": 50.0})


def test_limit_of_an_axis_that_the_backend_has_is_taken():
    supervisor(("x", "y"), **{"y.maximum_voltage_v": 50.0})
