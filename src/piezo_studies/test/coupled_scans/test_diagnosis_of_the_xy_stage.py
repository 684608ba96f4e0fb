# SPDX-License-Identifier: BSD-3-Clause
"""Changes of the simulated XY stage, which shares no code with the model, are named."""

from dataclasses import replace

import pytest

from piezo_identification.axes.diagnose_axes import diagnose_axes
from piezo_identification.axes.identify_axes import identify_several_axes
from piezo_identification.axes.predict_axes import predict_several_axes
from piezo_identification.experiments.several_axes import orthogonal_multisines
from piezo_studies.coupled_scans import xy_stage


def turned(config):
    x_rad, y_rad = config.mechanics.sensors_askew_rad
    return replace(config, mechanics=replace(
        config.mechanics, sensors_askew_rad=(x_rad, y_rad - 0.005)))


def late(config):
    own = config.axes["y"]
    delay, *others = own.sensor
    later = replace(delay, delay_s=delay.delay_s + 2e-5)
    return replace(config, axes={**config.axes, "y": replace(own, sensor=(later, *others))})


@pytest.fixture
def record(monkeypatch):
    monkeypatch.setattr(xy_stage, "axes_experiments", lambda *_: orthogonal_multisines(
        xy_stage.LIMITS, period_s=0.2, highest_hz=1500.0))

    def recorded(seed, change=lambda plant: plant):
        return xy_stage.recorded("multisine", seed, change(xy_stage.linear_plant()))

    return recorded


@pytest.mark.long
def test_turned_sensor_and_delay_are_named(record):
    known, unseen = record(1), record(9)
    identified = identify_several_axes(known, unseen[-1:])
    assert diagnose_axes(identified, record(50)[-1]).verdict == "none"
    for change, name, place, parameter, value in (
            (turned, "squareness", {"axis": "y", "from_axis": "x"}, "angle_rad", 0.005),
            (late, "delay", {"axis": "y"}, "delay_s", 2e-5)):
        *_, other, last = record(50, change)
        diagnosis = diagnose_axes(identified, last)
        assert diagnosis.verdict == "explained"
        effect, = diagnosis.effects
        off = effect["standard_deviations"][parameter]
        assert effect["name"] == name
        assert effect["parameters"] == place | {
            parameter: pytest.approx(value, abs=3.0 * off)}
        assert off < 0.3 * value
        errors = predict_several_axes(diagnosis.extended.model, other).e_y_percent()
        assert max(errors.values()) < 0.2
