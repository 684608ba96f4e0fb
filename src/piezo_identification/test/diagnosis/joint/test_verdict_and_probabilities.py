# SPDX-License-Identifier: BSD-3-Clause
"""The verdict follows from the probabilities, even where the fit to all recordings goes astray."""

from dataclasses import replace

import numpy as np
import pytest
from made_by_scipy import behind_mode, line_model, logged, smooth_noise_v

from piezo_identification.diagnosis.diagnose import diagnose
from piezo_identification.diagnosis.joint.identification_recordings import (
    IdentificationRecordings,
)
from piezo_identification.fitting.free_parameters import changed_model
from piezo_identification.fitting.joint_errors import JointErrors, simulated_by
from piezo_identification.fitting.joint_fit import SETTINGS, JointFit, JointProblem
from piezo_identification.simulation import past_search

pytestmark = pytest.mark.usefixtures("without_ceiling", "likely_effects")

SAMPLES, NOISE_UM = 1800, 2e-3
MODE = (400.0, 0.1)
MODEL = line_model(*MODE)


def with_second_mode(displacement_um, voltage_v):
    return 0.98 * displacement_um + 0.02 * behind_mode(0.1 * voltage_v, 250.0, 0.02)


def with_steps_of_its_own(displacement_um, voltage_v):
    """Add what no effect is: levels that change at random with nothing to tell when."""
    generator = np.random.default_rng(7)
    levels_um = np.repeat(generator.normal(size=SAMPLES // 60), 60)
    return displacement_um + 0.1 * levels_um


def unchanged(displacement_um, voltage_v):
    return displacement_um


def recording(seed, change):
    generator = np.random.default_rng(seed)
    voltage_v = smooth_noise_v(generator, SAMPLES, 20)
    displacement_um = change(behind_mode(0.1 * voltage_v, *MODE), voltage_v)
    noise_um = NOISE_UM * generator.normal(size=SAMPLES)
    return logged(voltage_v, displacement_um + noise_um, name=f"{seed}")


def gone_astray(self, effects, later=(), begun=None, held=()):
    """End with effects as they were guessed, beside a mode that is 1 % off."""
    changes = np.zeros(self.dataset.regressors.shape[1] - self.dataset.nuisance_count)
    changes[0] = 0.05
    came = frozenset(later)
    bent = replace(self.start, dataset=simulated_by(
        self.dataset, changed_model(self.dataset.model, changes), self.new_count, came))
    return JointFit(bent, (*effects, *held), came)


@pytest.mark.parametrize(("change", "joint_fit", "verdict", "likeliest"), [
    (unchanged, gone_astray, "none", "none"),
    pytest.param(with_second_mode, JointProblem.fit, "explained", "vibration_mode",
                 marks=pytest.mark.long),
    (with_second_mode, gone_astray, "explained", "vibration_mode"),
    (with_steps_of_its_own, gone_astray, "unexplained", "something_else"),
])
def test_the_verdict_follows_from_the_probabilities(
        monkeypatch, change, joint_fit, verdict, likeliest):
    monkeypatch.setattr(JointProblem, "fit", joint_fit)
    new, old = (recording(seed, change) for seed in (1, 2))
    diagnosis = diagnose(MODEL, [new], identified_from=IdentificationRecordings((old,), ()))
    shares = diagnosis.probabilities
    assert sum(shares.values()) == pytest.approx(1.0)
    assert (diagnosis.verdict, next(iter(shares))) == (verdict, likeliest)
    assert (shares["something_else"] >= 0.5) is (verdict == "unexplained")


@pytest.mark.long
def test_what_is_expensive_is_asked_for_seldom(monkeypatch):
    pasts, fits, derivatives = [], [], []

    def counted(owner, name, note):
        real = getattr(owner, name)

        def noted(*arguments, **options):
            note(*arguments, **options)
            return real(*arguments, **options)

        monkeypatch.setattr(owner, name, noted)

    counted(past_search, "starting_past_v",
            lambda model, part: pasts.append(part.path))
    counted(JointProblem, "fit", lambda *arguments, **options: fits.append("held" in options))
    counted(JointErrors, "_of_model", lambda *arguments: derivatives.append(arguments))
    new, old = (recording(seed, with_steps_of_its_own) for seed in (1, 2))
    diagnosis = diagnose(MODEL, [new], identified_from=IdentificationRecordings((old,), ()))
    assert diagnosis.verdict == "unexplained"
    assert sorted(pasts) == ["1", "2"]
    # Where an effect is held, the derivatives are those beside it.
    freely = fits.count(False)
    assert fits.count(True) > 0
    assert freely < 40
    assert len(derivatives) <= 2 * SETTINGS.steps * freely
