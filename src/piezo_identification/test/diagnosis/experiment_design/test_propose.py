# SPDX-License-Identifier: BSD-3-Clause
"""Alternatives, expected outcomes and proposals against what is known of the effects."""

import json
from dataclasses import replace

import numpy as np
import pytest

from piezo_identification.commands import propose_work
from piezo_identification.commands.propose_command import main
from piezo_identification.conditioning.row_alignment import rows_read_at_start
from piezo_identification.diagnosis.comparison.criteria import Reason
from piezo_identification.diagnosis.experiment_design import expected_outcome as expected
from piezo_identification.diagnosis.experiment_design.alternative_explanations import effects_of
from piezo_identification.diagnosis.experiment_design.propose import (
    Proposal,
    alternatives_of_files,
    grid,
    propose,
    save_proposal,
    waveform,
)
from piezo_identification.experiments.catalogue import Experiment, StageLimits
from piezo_models.effects.delay import Delay
from piezo_models.effects.sensor_lag import SensorLag
from piezo_models.identified_model import IdentifiedModel
from piezo_models.model_file import save_model

DELAY_S = 1e-4
VERDICT = {
    "verdict": "explained",
    "effects": [{"name": "delay", "parameters": {"delay_s": DELAY_S},
                 "error_reduction_percent": 90.0}],
    "not_decidable": ["sensor_lag", "thermal_drift"],
    "not_decidable_because": {
        "sensor_lag": "the data does not distinguish it from delay",
        "thermal_drift": "in so short a time, a drift looks like creep that had begun before"},
    "not_told_from": {"sensor_lag": "delay"},
}
LIMITS = StageLimits(-20.0, 120.0, 1e5, 10_000.0)
SLOW = Experiment("scan", 50.0 - 25.0 * np.cos(0.02 * np.pi * np.arange(1000)), 1e-3, 1, "")


@pytest.fixture(scope="module")
def scanned(plant, play):
    """A slow scan of a stage with a delay: a lag explains it as well."""
    return play(SLOW, 1, 10_000.0, stage=replace(plant, effects=(Delay(DELAY_S),)))


@pytest.fixture(scope="module")
def alternatives(plant, scanned):
    return alternatives_of_files(plant, [scanned], VERDICT)


def chirp(highest_hz, duration_s=0.3):
    time_s = np.arange(round(duration_s * LIMITS.sample_rate_hz)) / LIMITS.sample_rate_hz
    wave = np.sin(np.pi * highest_hz / duration_s * time_s**2)
    return Experiment("chirp", 50.0 + 8.0 * wave, 1.0 / LIMITS.sample_rate_hz, 1, "")


def test_alternatives_are_those_that_the_data_does_not_tell_apart(alternatives):
    assert set(alternatives.probabilities) == {"delay", "sensor_lag"}
    assert sum(alternatives.probabilities.values()) == pytest.approx(1.0)
    assert max(alternatives.probabilities.values()) < 0.95
    for alternative in alternatives.alternatives:
        effect, = alternative.effects
        assert effect.name == alternative.name
    lag = next(each.effects[0] for each in alternatives.alternatives
               if each.name == "sensor_lag")
    assert isinstance(lag, SensorLag)
    # Slow motion shows the sum of the lags alone.
    assert lag.lag().D.size == 1 and -lag.lag()(1e-3j).imag * 1e3 == pytest.approx(
        DELAY_S, rel=0.2)


def test_sets_that_a_verdict_gives_a_probability_are_alternatives(plant, scanned):
    alone = {name: value for name, value in VERDICT.items() if "not_decidable" not in name}
    given = {"delay": 0.6, "sensor_lag": 0.3, "none": 0.0, "something_else": 0.1}
    alternatives = alternatives_of_files(plant, [scanned], alone | {"probabilities": given})
    assert set(alternatives.probabilities) == {"delay", "sensor_lag"}
    only = alternatives_of_files(
        plant, [scanned], alone | {"probabilities": {"delay": 0.9999, "sensor_lag": 1e-9}})
    assert set(only.probabilities) == {"delay"}
    assert propose(only, LIMITS) is None


@pytest.mark.parametrize(("reason", "is_alternative"), [
    (Reason.SAME_AS_OTHER_PARAMETERS, True), (Reason.NOT_EXCITED, False)])
def test_an_effect_that_is_not_named_is_an_alternative_by_the_kind_of_its_reason(
        plant, scanned, reason, is_alternative):
    verdict = {"effects": [], "not_decidable": ["delay"],
               "not_decidable_because": {"delay": "in other words"},
               "not_decidable_reasons": {"delay": str(reason)}}
    found = alternatives_of_files(plant, [scanned], verdict)
    assert ("delay" in found.probabilities) is is_alternative


def test_fast_motion_tells_a_delay_from_a_lag_and_slow_motion_does_not(alternatives):
    slow, fast = (expected.expected_outcome(alternatives, chirp(frequency_hz), LIMITS)
                  for frequency_hz in (10.0, 1500.0))
    order = [alternative.name for alternative in alternatives.alternatives]
    true, other = order.index("delay"), order.index("sensor_lag")
    assert slow.distance[true, other] < 1.0
    assert slow.probability < 0.5
    assert fast.distance[true, other] > 5.0 * max(1.0, slow.distance[true, other])
    assert np.all(np.diag(fast.rms_um) == 0.0)


@pytest.mark.parametrize("frequency_hz", [10.0, 150.0, 1500.0])
def test_alternatives_are_at_least_as_far_apart_with_fixed_parameters(alternatives, frequency_hz):
    fixed, refitted = (expected.expected_outcome(
        alternatives, chirp(frequency_hz), LIMITS, is_refitted) for is_refitted in (False, True))
    assert np.all(fixed.distance >= refitted.distance)
    assert fixed.rank > refitted.rank


def test_more_noise_and_more_misfit_bring_alternatives_together(alternatives):
    before = expected.expected_outcome(alternatives, chirp(1500.0), LIMITS)
    for change in ({"alike": 4.0 * alternatives.alike},
                   {"misfit": alternatives.misfit + 0.01}):
        after = expected.expected_outcome(replace(alternatives, **change), chirp(1500.0), LIMITS)
        # What the recordings so far know of the parameters then counts for more.
        assert after.rms_um == pytest.approx(before.rms_um, rel=0.1)
        assert after.distance[0, 1] < before.distance[0, 1]


def test_the_probability_of_deciding_is_that_of_gaussian_errors():
    distance, chances = np.array([[0.0, 3.0], [2.5, 0.0]]), np.array([0.6, 0.4])
    found = expected._deciding(distance, chances)
    random = np.random.default_rng(1)
    for true, apart in ((0, 3.0), (1, 2.5)):
        # The logarithm of the ratio of likelihoods of two means that far apart.
        ratio = 0.5 * apart**2 + apart * random.normal(size=200_000)
        ratio = ratio + np.log(chances[true] / chances[1 - true])
        assert found[true] == pytest.approx(np.mean(ratio > np.log(19.0)), abs=0.01)


@pytest.mark.parametrize("point", grid(), ids=lambda point: (
    f"{point.family.name}-{point.level:g}-{point.rate_hz:g}"))
@pytest.mark.parametrize("limits", [LIMITS, StageLimits(0.0, 10.0, 2e3, 5000.0)])
def test_waveforms_stay_within_the_limits(point, limits):
    made = waveform(limits, 5.0, point)
    assert made.voltage_v.min() >= limits.voltage_min_v
    assert made.voltage_v.max() <= limits.voltage_max_v
    assert made.duration_s <= 5.0 + 1e-9
    steps_v = np.abs(np.diff(made.voltage_v))
    assert steps_v.max() * limits.sample_rate_hz <= limits.slew_limit_v_per_s * (1.0 + 1e-9)
    assert steps_v.max() > 0.0
    held = made.sample_period_s * limits.sample_rate_hz
    assert held == pytest.approx(round(held))


def test_waveforms_of_a_slow_clock_have_the_samples_that_a_comparison_needs():
    limits = StageLimits(0.0, 10.0, 2e3, 100.0)
    assert min(waveform(limits, 30.0, point).voltage_v.size for point in grid()) == 1000


def test_the_best_waveform_is_found_and_written_for_stage_play(alternatives, monkeypatch, tmp_path):
    design = "piezo_identification.diagnosis.experiment_design.propose."
    few = [point for point in grid() if point.family.name in ("sweep", "slow_sweep")]
    few = few[:1] + few[-1:]
    monkeypatch.setattr(design + "grid", lambda: few)
    monkeypatch.setattr(design + "FACTORS", (1.6,))
    told = []
    proposal = propose(alternatives, LIMITS, 0.5, lambda what, fraction: told.append(fraction))
    assert isinstance(proposal, Proposal)
    assert told == sorted(told) and told[-1] < 1.0
    assert proposal.outcome.probability > 0.9
    for point in few:
        outcome = expected.expected_outcome(alternatives, waveform(LIMITS, 0.5, point), LIMITS)
        assert proposal.outcome.rank >= outcome.rank
    table, told_of = save_proposal(proposal, tmp_path / "next")
    # `stage play` reads these columns.
    columns = np.genfromtxt(table, delimiter=",", names=True)
    voltage_v = columns["voltage_v"]
    assert np.allclose(np.diff(columns["time_s"]), proposal.experiment.sample_period_s, rtol=1e-3)
    assert np.allclose(voltage_v, proposal.experiment.voltage_v, rtol=1e-8)
    document = json.loads(told_of.read_text())
    assert {each["effects"] for each in document["alternatives"]} == {"delay", "sensor_lag"}
    assert document["probability_of_deciding"] == proposal.outcome.probability
    assert all(difference > 0.0 for alternative in document["alternatives"]
               for difference in alternative["expected_rms_difference_um"].values())


def test_command_writes_waveform_and_outcome(plant, play, csv_of, tmp_path, monkeypatch, capsys):
    design = "piezo_identification.diagnosis.experiment_design.propose."
    last = grid()[-1:]
    monkeypatch.setattr(design + "grid", lambda: last)
    monkeypatch.setattr(design + "FACTORS", ())
    save_model(tmp_path / "model.json", IdentifiedModel(plant, (-20.0, 120.0)))
    given = {"probabilities": {"delay": 0.5, "sensor_lag": 0.5}}
    (tmp_path / "verdict.json").write_text(json.dumps(VERDICT | given))
    scan = Experiment("scan", 50.0 - 25.0 * np.cos(2e-3 * np.pi * np.arange(3000)), 1e-4, 1, "")
    scanned = play(scan, 1, 10_000.0, stage=replace(plant, effects=(Delay(DELAY_S),)))
    csv_of(scanned, tmp_path / "scan.csv")
    arguments = ["--model", str(tmp_path / "model.json"), "--verdict",
                 str(tmp_path / "verdict.json"), "--data", str(tmp_path / "scan.csv"),
                 "--output", str(tmp_path / "next"), "--longest-s", "0.5",
                 "--sample-rate-hz", "10000", "--slew-limit-v-per-s", "1e5"]
    assert main(arguments) == 0
    told = capsys.readouterr().out
    assert "distinguishes" in told and "stage play" in told
    assert (tmp_path / "next" / "next_experiment.csv").exists()
    (tmp_path / "verdict.json").write_text("[]")
    assert main(arguments) == 2
    assert "has no effects: give the verdict.json" in capsys.readouterr().err
    assert main([*arguments, "--longest-s", "0"]) == 2
    assert "--longest-s is 0: give a number above 0" in capsys.readouterr().err


def test_command_reads_rows_as_the_diagnosis_read_them(
        plant, play, csv_of, tmp_path, monkeypatch, capsys):
    """The logger reads the displacement of a row at the end of its hold, as the model file says."""
    row = {"read_at_samples": 1.0, "delay_s": 0.0, "standard_deviation_s": 0.0}
    save_model(tmp_path / "model.json",
               IdentifiedModel(plant, (-20.0, 120.0), rows={"dynamics": row}))
    (tmp_path / "verdict.json").write_text(json.dumps(VERDICT))
    late = rows_read_at_start(play(chirp(2000.0), 1, 10_000.0), -1.0)
    csv_of(late, tmp_path / "late.csv")
    given = []

    def stop(model, recordings, *_):
        given.extend(recordings)
        raise ValueError("seen")

    monkeypatch.setattr(propose_work, "alternatives_of_files", stop)
    assert main(["--model", str(tmp_path / "model.json"), "--verdict",
                 str(tmp_path / "verdict.json"), "--data", str(tmp_path / "late.csv"),
                 "--output", str(tmp_path / "next")]) == 2
    assert "read 1 sample periods after their voltage" in capsys.readouterr().out
    assert given[0].sample_index[0] == 1


def test_effects_that_nobody_knows_are_refused():
    with pytest.raises(ValueError, match="names the effect gremlins"):
        effects_of({"effects": [{"name": "gremlins", "parameters": {}}]})
    with pytest.raises(ValueError, match="parameters of delay are not those"):
        effects_of({"effects": [{"name": "delay", "parameters": {"colour": 1.0}}]})


def test_limits_apart_from_the_model_are_refused(alternatives):
    with pytest.raises(ValueError, match="give limits within the model's"):
        propose(alternatives, StageLimits(130.0, 200.0))
