# SPDX-License-Identifier: BSD-3-Clause
"""What an odd multisine says of a cause, against stages whose cause is known."""

from dataclasses import replace

import numpy as np
import pytest

from piezo_common.report_page import render_page
from piezo_identification.analysis.distortion_over_frequency import (
    distortion_bands,
    distortion_png,
    distortion_rows,
)
from piezo_identification.analysis.nonlinear_distortion import (
    error_distortion,
    excluded_by_distortion,
)
from piezo_identification.diagnosis.diagnose import diagnose
from piezo_identification.diagnosis.report.diagnosis_report import (
    distortion_sections,
    render_report,
)
from piezo_identification.experiments.catalogue import StageLimits, distortion
from piezo_identification.simulation.past_search import simulated_recording
from piezo_models.effects import known_effects
from piezo_models.effects.backlash import Backlash
from piezo_models.effects.delay import Delay
from piezo_models.effects.rate_dependent_hysteresis import RateDependentHysteresis
from piezo_models.effects.sensor_lag import SensorLag
from piezo_models.effects.sensor_nonlinearity import SensorNonlinearity
from piezo_models.effects.slew_limit import SlewLimit
from piezo_models.effects.stiffening import Stiffening
from piezo_models.effects.vibration_mode import VibrationMode
from piezo_models.effects.voltage_clipping import VoltageClipping

CLOCK_HZ = 10_000.0
LINEAR = [Delay(2e-4), SensorLag(1e-4), VibrationMode(2.0 * np.pi * 700.0, 0.05, 0.05)]
CURVED = [
    Backlash(0.2), RateDependentHysteresis(0.5, 1e3, 0.3, 1e-3), SlewLimit(1.5e4),
    Stiffening(0.0, 0.0, 1.0, 30.0, 30.0, 0.0, 1.0), VoltageClipping(-20.0, 72.0, 2.0),
    Stiffening(0.0, 1.0, 0.0, 30.0, 30.0, 0.0, 1.0),
    SensorNonlinearity(0.0, 0.0, 0.3, 0.0, 30.0, 30.0),
    SensorNonlinearity(0.5, 0.3, 0.0, 0.0, 30.0, 30.0),
]


@pytest.fixture(scope="module")
def record(plant, play):
    experiment = distortion(
        StageLimits(sample_rate_hz=CLOCK_HZ), period_s=0.25, periods=4, highest_hz=800.0)

    def record_with(*effects):
        return play(experiment, 1, CLOCK_HZ, stage=replace(plant, effects=effects))

    return record_with


def part_of(plant, recording):
    part = simulated_recording(plant, recording)
    return part, error_distortion(part, part.measured_um - part.simulate())


@pytest.mark.parametrize("cause", LINEAR, ids=lambda cause: cause.name)
def test_a_linear_cause_leaves_no_distortion_and_excludes_what_distorts(plant, record, cause):
    part, found = part_of(plant, record(cause))
    assert found.shown() == {"linear"}
    assert "the cause is linear" in found.sentence()
    excluded = excluded_by_distortion([part], list(known_effects().values()))
    assert set(excluded) == {
        "amplitude_damping", "backlash", "bouc_wen_hysteresis", "curved_bouc_wen_hysteresis",
        "hysteresis", "hysteretic_spring",
        "rate_dependent_hysteresis", "slew_limit",
        "stiffening", "sensor_nonlinearity", "voltage_clipping"}


@pytest.mark.parametrize("cause", CURVED, ids=lambda cause: cause.name)
def test_a_cause_that_distorts_is_never_excluded(plant, record, cause):
    part, found = part_of(plant, record(cause))
    assert found.shown() & {"even", "odd"}
    assert cause.name not in excluded_by_distortion([part], list(known_effects().values()))


def test_the_symmetry_of_a_cause_behind_a_linear_stage_is_told(plant, record):
    # Without hysteresis in between, the operating point is where the polynomial is centred.
    whole = record()
    voltage_v = whole.voltage_v
    answer_um = 0.4 * (voltage_v - 50.0)
    noise = 1e-4 * np.random.default_rng(2).normal(size=voltage_v.size)
    for power, size, shown, word in (
            (2, 2e-3, "even", "asymmetric"), (3, 2e-4, "odd", "symmetric")):
        part = simulated_recording(plant, replace(whole, displacement_um=part_um(plant, whole)
                                                 + size * answer_um**power + noise))
        found = error_distortion(part, part.measured_um - part.simulate())
        assert shown in found.shown()
        assert len(found.shown() & {"even", "odd"}) == 1
        assert f"is {word}" in found.sentence()


def part_um(plant, recording):
    """Return what the model of the stage simulates at all samples of a recording."""
    part = simulated_recording(plant, recording)
    whole = np.full(recording.voltage_v.size, part.rest_um)
    whole[recording.playing] = part.simulate()
    return whole


def test_a_model_that_lacks_nothing_shows_nothing(plant, record):
    part, found = part_of(plant, record())
    assert found.shown() == frozenset()
    assert "no missing effect" in found.sentence()
    assert excluded_by_distortion([part], list(known_effects().values())) == {}


def test_bands_hold_all_lines_and_their_powers_add_up(plant, record):
    _, found = part_of(plant, record(Delay(2e-4)))
    bands = distortion_bands(found.answer)
    assert 3 <= len(bands) <= 6
    assert np.array_equal(np.concatenate([band.frequency_hz for band in bands]),
                          found.answer.frequency_hz)
    assert np.sqrt(sum(band.answer_um**2 for band in bands)) == pytest.approx(
        found.answer.answer_um)
    rows = distortion_rows(found.error)
    assert len({len(row) for row in rows}) == 1
    assert rows[-1][0] == "all" and rows[-1][3].startswith("below")
    assert distortion_png(found.answer).startswith(b"\x89PNG")


def test_the_report_tells_the_error_before_and_after_and_over_frequency(plant, record):
    part, found = part_of(plant, record(Delay(2e-4)))
    before_um = part.measured_um - part.simulate()
    after_um = part.measured_um - part.simulate((Delay(2e-4),))
    first, second = distortion_sections(part, before_um, after_um)
    assert "the cause is linear" in first.paragraphs[0]
    linear = dict((row[0], row[1:]) for row in first.table)["linear"]
    assert float(linear[1]) == pytest.approx(
        100.0 * found.error.linear_um / found.answer.answer_um, rel=0.01)
    assert float(linear[2]) < 0.01 * float(linear[1])
    assert [picture.png[:4] for picture in first.pictures] == [b"\x89PNG"] * 2
    assert second.table == distortion_rows(found.answer)
    page = render_page("", [], [first, second])
    assert "Distortion of the residual" in page


@pytest.mark.long
def test_a_diagnosis_tries_no_effect_that_the_multisine_excludes(plant, record):
    diagnosis = diagnose(plant, [record(Delay(2e-4))])
    assert [entry["name"] for entry in diagnosis.effects] == ["delay"]
    tried = {attempt.name for attempt in diagnosis.selection.rounds[0]}
    assert "sensor_lag" in tried and "backlash" not in tried
    assert "Distortion in distortion" in render_report(diagnosis)
