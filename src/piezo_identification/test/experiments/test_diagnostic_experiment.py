# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from piezo_identification.experiments.catalogue import StageLimits, named_experiment
from piezo_identification.fitting.dataset import simulate_recordings
from piezo_identification.fitting.recording_evidence import recording_evidence
from piezo_identification.fitting.regression import first_regression
from piezo_models.effects import known_effects


@pytest.fixture(scope="module")
def evidence(plant, play):
    experiment = named_experiment("diagnostic")
    regression = first_regression(simulate_recordings(plant, [play(experiment)]))
    return recording_evidence(regression)[0]


@pytest.mark.parametrize("limits", [
    StageLimits(), StageLimits(0.0, 60.0), StageLimits(-30.0, 150.0, 1e6, 50_000.0),
    StageLimits(slew_limit_v_per_s=1e5), StageLimits(sample_rate_hz=20_000.0),
])
def test_the_waveform_stays_within_the_limits_and_uses_the_whole_range(limits):
    experiment = named_experiment("diagnostic", limits)
    repeated_v = np.append(experiment.voltage_v, experiment.voltage_v[0])
    assert (repeated_v.min(), repeated_v.max()) == (limits.voltage_min_v, limits.voltage_max_v)
    slew_v_per_s = np.abs(np.diff(repeated_v)) * limits.sample_rate_hz
    assert slew_v_per_s.max() <= limits.slew_limit_v_per_s * (1.0 + 1e-9)
    assert experiment.repeats > 1


def test_it_begins_and_ends_where_the_memory_of_the_hysteresis_is_known():
    voltage_v = named_experiment("diagnostic").voltage_v
    assert voltage_v[0] == -20.0
    assert voltage_v[-1] == pytest.approx(-20.0, abs=0.01)


@pytest.mark.parametrize("kind", known_effects().values(), ids=lambda kind: kind.name)
def test_no_effect_lacks_excitation(evidence, kind):
    assert kind.lacks_excitation(evidence) is None
