# SPDX-License-Identifier: BSD-3-Clause
"""Planned voltages are played on a flexure that shares no code with the model."""

from dataclasses import replace

import control
import numpy as np
import pytest
import two_axis_flexure

from piezo_controller.axes.coupled_inverse import invert_path
from piezo_controller.axes.path_plan import UnreachablePath
from piezo_controller.axes.repeated_period import repeated
from piezo_controller.axes.scan import scan
from piezo_controller.axes.stored_scan import stored_scan, write_scan
from piezo_controller.references.kind import InvalidReference
from piezo_models import CoupledModel, Coupling, IdentifiedAxes, Softening
from piezo_models.axes.actuator import Actuator
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics

SETTLED_S = 0.9
"""The lowest mode has decayed to a millionth."""

FASTEST_HZ = 1.5 * two_axis_flexure.FREQUENCY_HZ.min()


@pytest.fixture(scope="module")
def model():
    return two_axis_flexure.model()


@pytest.fixture(scope="module")
def model_with_errors():
    """Return the model with errors of 1 % of frequencies and pushes, 10 % of the damping."""
    return two_axis_flexure.model((0.01, -0.01, 0.01), 0.1, 0.01)


def plan_of(model, kind, **fields):
    return scan(model, kind, slew_limit_v_per_s=1e8, **fields)


def done_um(plan):
    """Return one period of what the flexure does, once it has settled."""
    again = round(SETTLED_S / two_axis_flexure.PERIOD_S / len(plan.voltage_v)) + 1
    played_v = np.concatenate([plan.begin_voltage_v, *[plan.voltage_v] * (again + 1)])
    return two_axis_flexure.played_um(played_v)[-len(plan.voltage_v):]


def errors_percent(plan):
    left_um = done_um(plan) - plan.path.position_um
    travel_um = np.ptp(plan.path.position_um, axis=0)
    return 100.0 * np.sqrt(np.mean(left_um**2, axis=0)) / travel_um


def coupling_db(plan):
    """Return what y does over what x is asked for."""
    return 20.0 * np.log10(np.std(done_um(plan)[:, 1]) / np.std(plan.path.position_um[:, 0]))


@pytest.mark.parametrize(("kind", "fields", "most_percent"), [
    ("raster", {"size_um": (20, 20), "rate_hz": 100.0}, 0.05),
    ("raster", {"size_um": (20, 20), "rate_hz": 500.0}, 0.2),
    ("raster", {"size_um": (20, 20), "rate_hz": 500.0, "both_directions": True}, 0.2),
    ("lissajous", {"rate_hz": FASTEST_HZ}, 0.1),
    ("spiral", {"rate_hz": FASTEST_HZ}, 0.1),
    ("spiral", {"rate_hz": FASTEST_HZ, "linear_velocity": True}, 0.1),
    ("rosette", {"rate_hz": FASTEST_HZ}, 0.1),
    ("cycloid", {"rate_hz": FASTEST_HZ}, 0.1)])
def test_paths_are_followed_by_a_stage_whose_model_is_known(model, kind, fields, most_percent):
    plan = plan_of(model, kind, lines=10, **fields)
    assert errors_percent(plan).max() < most_percent
    # Ten times below what is allowed, and as it was predicted.
    assert errors_percent(plan).max() < 0.1 * most_percent + 1e-3
    np.testing.assert_allclose(
        plan.prediction.displacement_um["coupled"], done_um(plan), atol=1e-3)


def test_a_model_with_errors_of_one_percent_leaves_errors_of_a_few(model_with_errors):
    raster = plan_of(model_with_errors, "raster", size_um=(20, 20), rate_hz=100.0, lines=10)
    assert 0.05 < errors_percent(raster).max() < 1.5
    lissajous = plan_of(model_with_errors, "lissajous", rate_hz=FASTEST_HZ, lines=10)
    assert 0.1 < errors_percent(lissajous).max() < 5.0


@pytest.mark.parametrize("rate_hz", [50.0, 150.0, 250.0, 310.0])
def test_what_x_does_is_not_seen_in_y(model, model_with_errors, rate_hz):
    sine = {"size_um": (10.0, 0.0), "rate_hz": rate_hz, "lines": 2}
    plan = plan_of(model, "lissajous", **sine)
    plain_v = invert_path(plan.path.position_um, model, "none").voltage_v
    before_db = coupling_db(replace(plan, voltage_v=plain_v))
    assert before_db > -30.0
    assert coupling_db(plan) < (-60.0 if rate_hz < 310.0 else -40.0)
    assert coupling_db(plan_of(model_with_errors, "lissajous", **sine)) < before_db - 25.0


def test_each_inverse_is_better_than_the_one_before(model):
    plan = plan_of(model, "raster", size_um=(10, 10), rate_hz=100.0, lines=10)
    none, diagonal, coupled = (
        plan.prediction.error_percent[each].max() for each in ("none", "diagonal", "coupled"))
    assert none > 5.0 * diagonal > 100.0 * coupled
    alone = plan.prediction.coupling_db
    assert alone["diagonal"][1, 0] > -40.0
    assert alone["coupled"][1, 0] < -100.0
    printed = repr(plan.summary())
    assert "y from x" in printed
    assert "x error" in printed


def test_what_is_said_to_be_in_reach_is_in_reach(model):
    fields = {"rate_hz": 200.0, "lines": 10, "both_directions": True}
    limits = {"voltage_range_v": [(-24.0, 24.0), (-25.0, 40.0)]}
    with pytest.raises(UnreachablePath, match="it takes x voltages from") as refused:
        scan(model, "raster", size_um=(10, 10), **fields, **limits)
    size_um = refused.value.reachable_size_um
    assert f"{size_um[0]:.4g} x {size_um[1]:.4g} um at this rate" in str(refused.value)
    assert np.all(size_um > 3.0)
    plan = scan(model, "raster", size_um=tuple(size_um), **fields, **limits)
    assert np.abs(plan.voltage_v[:, 0]).max() > 0.99 * 24.0
    fields["rate_hz"] = refused.value.reachable_rate_hz
    assert 50.0 < fields["rate_hz"] < 200.0
    scan(model, "raster", size_um=(10, 10), **fields, **limits)


def test_a_plan_that_is_planned_again_from_its_file_has_its_marks_and_pixels(model, tmp_path):
    plan = plan_of(model, "raster", size_um=(5.0, 5.0), rate_hz=50.0, lines=8, pixels=6,
                   sensor_delay_s=(3e-4, 7e-4))
    write_scan(stored_scan(plan), tmp_path)
    again = plan_of(model, "file", file=tmp_path / "path.csv", sensor_delay_s=(3e-4, 7e-4))
    assert plan.marks.any() and not np.array_equal(plan.marks, plan.path.marks)
    np.testing.assert_array_equal(again.marks, plan.marks)
    assert (again.frame.axes, again.frame.pixels) == (plan.frame.axes, plan.frame.pixels)
    assert again.frame.pixel_um == pytest.approx(plan.frame.pixel_um, rel=0.05)
    assert again.frame.centre_um == pytest.approx(plan.frame.centre_um, abs=0.1)


def test_marks_come_before_the_readings_by_the_delay_of_the_axis_that_moves_fast(model):
    fields = {"size_um": (5.0, 5.0), "rate_hz": 100.0, "lines": 10}
    for axes, late in ((("x", "y"), 4), (("y", "x"), 16)):
        plan = plan_of(model, "raster", axes=axes, sensor_delay_s=(1e-4, 4e-4), **fields)
        assert np.array_equal(plan.marks, np.roll(plan.path.marks, -late))
        assert plan.columns()["pixel"].sum() == 100
    whole = plan_of(model, "raster", **fields)  # the model knows whole samples alone
    assert np.array_equal(whole.sensor_delay_s, model.latency_samples * model.sample_period_s)


def test_lag_of_the_amplifiers_is_no_delay_of_the_sensors():
    s, omega = control.tf("s"), 2.0 * np.pi * np.array([300.0, 400.0])
    modes = [control.ss(0.2 * w**2 / ((s**2 + 0.02 * w * s + w**2) * (1.0 + 8e-5 * s)))
             for w in omega]
    lagging = CoupledModel.from_control(
        control.sample_system(control.append(*modes), two_axis_flexure.PERIOD_S), ("x", "y"))
    frequency_hz = np.geomspace(1.0, 1e4, 10)
    gain, poles = lagging.response(frequency_hz), lagging.poles_rad_per_s.size
    identified = IdentifiedAxes(
        lagging, np.array([[-60.0, 60.0]] * 2), Coupling(frequency_hz, gain, 0.0 * gain),
        np.zeros(poles, complex), 0.0 * lagging.residues_um_per_v,
        np.array([1e-4, 5e-5]), np.array([1e-6, 1e-6]))
    plan = plan_of(identified, "raster", size_um=(5.0, 5.0), rate_hz=100.0, lines=10)
    assert plan.sensor_delay_s == pytest.approx([2e-5, 0.0], abs=2e-6)


@pytest.mark.parametrize(("kind", "fields", "axes", "pixels", "pixel_um"), [
    ("raster", {"pixels": 20}, ["x", "y"], [20, 10], [0.3, 4.0 / 9.0]),
    ("raster", {"pixels": 20, "axes": ("y", "x")}, ["y", "x"], [20, 10], [0.3, 4.0 / 9.0]),
    ("spiral", {}, ["x", "y"], [21, 21], [6.0 / 21, 4.0 / 21]),  # 44 turns of 10 pixels
])
def test_pixels_of_the_image_are_those_of_the_lines_or_as_many_as_are_marked(
        model, kind, fields, axes, pixels, pixel_um):
    plan = plan_of(model, kind, size_um=(6.0, 4.0), rate_hz=100.0, lines=10, **fields)
    frame = plan.frame
    assert (frame.axes, frame.pixels) == (axes, pixels)
    assert frame.pixel_um == pytest.approx(pixel_um)
    assert frame.marked_pixels == plan.columns()["pixel"].sum()


def test_short_lines_of_a_high_image_run_along_the_fast_axis(model):
    frame = plan_of(model, "raster", size_um=(0.5, 10.0), rate_hz=20.0, lines=5, pixels=7).frame
    assert (frame.axes, frame.pixels) == (["x", "y"], [7, 5])
    assert frame.pixel_um == pytest.approx([0.5 / 7, 10.0 / 4])


def test_plan_without_the_inverse_has_the_static_gain_of_each_axis(model):
    plan = plan_of(model, "raster", size_um=(5.0, 5.0), rate_hz=100.0, lines=10).without_inverse()
    gain = np.diag(model.response(0.0)[0].real)
    assert np.allclose((plan.voltage_v - model.operating_voltage_v) * gain,
                       plan.path.position_um - model.operating_displacement_um)


def test_the_slew_limit_and_the_centre_are_in_the_refusal(model):
    with pytest.raises(UnreachablePath, match="more than the slew limit of 1e\\+04 V/s"):
        scan(model, "spiral", rate_hz=300.0, lines=5, slew_limit_v_per_s=1e4)
    with pytest.raises(UnreachablePath, match="cannot hold the centre"):
        scan(model, "spiral", rate_hz=300.0, lines=5, centre_um=(50.0, 0.0),
                     voltage_range_v=(-100.0, 100.0))
    with pytest.raises(UnreachablePath, match="and no rate at this size"):
        scan(model, "spiral", rate_hz=300.0, lines=5, voltage_range_v=(-1.0, 1.0))


def test_the_gain_is_limited_and_what_that_costs_is_said(model):
    fields = {"size_um": (10, 10), "rate_hz": 500.0, "lines": 10}
    free, limited = (plan_of(model, "raster", **fields, gain_limit=limit) for limit in (1e4, 5.0))
    assert np.ptp(limited.voltage_v) < 0.7 * np.ptp(free.voltage_v)
    left_um = limited.prediction.displacement_um["coupled"] - limited.path.position_um
    np.testing.assert_allclose(np.sqrt(np.mean(left_um**2, axis=0)), limited.left_out_um,
                               rtol=1e-3)
    assert limited.left_out_um.max() > 100.0 * free.left_out_um.max()


def test_axes_that_look_in_one_direction_are_refused(model):
    alike = CoupledModel(
        ("x", "y"), 1e-4, np.zeros(0, complex), np.zeros((0, 2, 2), complex),
        np.array([[[1.0, 1.0], [1.0, 1.0001]]]), np.zeros(2, int), np.zeros(2), np.zeros(2))
    with pytest.raises(ValueError, match="cannot be separated"):
        scan(alike, "spiral")
    with pytest.raises(InvalidReference, match="the path moves z"):
        scan(model, "spiral", axes=("x", "z"))


def test_an_axis_that_the_path_leaves_out_is_held(model):
    three = control.append(model.to_control(), control.ss([[0.5]], [[0.5]], [[0.1]], [[0.0]],
                                                        two_axis_flexure.PERIOD_S))
    of_three = CoupledModel.from_control(three, ("x", "y", "z"), np.full(3, 50.0), np.full(3, 5.0))
    plan = plan_of(of_three, "rosette", axes=("z", "x"), rate_hz=50.0, lines=4)
    assert plan.path.position_um[:, 1] == pytest.approx(5.0)
    assert plan.path.position_um[:, [0, 2]].mean(axis=0) == pytest.approx([5.0, 5.0])
    done = repeated(plan.voltage_v, of_three)
    np.testing.assert_allclose(done, plan.path.position_um, atol=1e-4)
    assert np.ptp(plan.voltage_v[:, 1]) > 0.0


@pytest.mark.parametrize(("kind", "rate_hz"), [("raster", 100.0), ("lissajous", 100.0)])
def test_softening_within_a_period_is_taken_off(model, kind, rate_hz):
    # The elongation that acts back is a twentieth of the motion, the memory shorter than a period.
    soft = replace(model, softening=Softening(
        -0.2 * model.residues_um_per_v[None], np.zeros((1, 2, 2)), 5.0, 0.02, (0.0, 20.0)))
    plan = plan_of(soft, kind, size_um=(5, 5), rate_hz=rate_hz, lines=8)
    position_um = plan.path.position_um
    stiff_v = invert_path(position_um, model).voltage_v
    before, after = (np.std(repeated(each, soft) - position_um) for each in (
        stiff_v, plan.voltage_v))
    assert after < 1e-4 * np.std(position_um)
    assert before > 30.0 * after


HALF_V, WEIGHT, RANGE_V = 2.0, 0.3, 80.0
"""Of a play beside the voltage of each axis, over voltages from -80 to 80 V."""


def with_plays(model):
    """Return the model with the play in front of each axis, as Preisach hysteresis."""
    cells = 320  # a play is a line of the density, as narrow as a cell
    cell_v, density = 2.0 * RANGE_V / cells, np.zeros((cells, cells))
    away = round(2.0 * HALF_V / cell_v)
    density[np.arange(away, cells), np.arange(cells - away)] = WEIGHT / cell_v
    hysteresis = PreisachModel(-RANGE_V, RANGE_V, density, 0.0, np.full(cells, 1.0 - WEIGHT))
    return replace(model, actuators=(Actuator(hysteresis),) * 2)


def behind_plays(voltage_v):
    """Return the drive, sample by sample."""
    moved_v = []
    for axis_v in voltage_v.T.tolist():
        moved, passed_v = axis_v[0] - HALF_V, []
        for now in axis_v:
            moved = min(max(moved, now - HALF_V), now + HALF_V)
            passed_v.append(moved)
        moved_v.append(passed_v)
    drive_v = (1.0 - WEIGHT) * voltage_v + WEIGHT * np.transpose(moved_v)
    return drive_v / (1.0 - WEIGHT * HALF_V / RANGE_V)


def test_a_path_is_followed_through_the_hysteresis_of_each_axis(model):
    fields = {"rate_hz": 40.0, "lines": 4, "size_um": (10.0, 10.0)}
    errors = []
    for planned in (model, with_plays(model)):
        plan = plan_of(planned, "spiral", **fields)
        played_v = np.concatenate([plan.begin_voltage_v, *[plan.voltage_v] * 9])
        left_um = (two_axis_flexure.played_um(behind_plays(played_v))[-len(plan.voltage_v):]
                   - plan.path.position_um)
        errors.append(100.0 * np.std(left_um, axis=0) / np.ptp(plan.path.position_um, axis=0))
    without, inverted = errors
    assert np.all(without > 1.0)
    assert np.all(inverted < 0.05 * without)


def test_what_creep_leaves_is_an_offset_as_on_the_stage_and_no_error(model):
    creeping = replace(model, actuators=(
        Actuator(creep=CreepDynamics((0.1,), (0.104,))), Actuator()))
    plan = plan_of(creeping, "raster", size_um=(10, 10), centre_um=(5.0, 0.0), rate_hz=100.0,
                   lines=10)
    prediction = plan.prediction
    offset_um = (done_um(plan) - plan.path.position_um).mean(axis=0)  # without the creep
    assert abs(offset_um[0]) > 0.1 and abs(offset_um[1]) < 0.01
    assert prediction.offset_um["coupled"] == pytest.approx(offset_um, rel=0.3, abs=0.01)
    assert np.max(prediction.error_percent["coupled"]) < 0.05
    assert "x offset" in repr(plan.summary())
