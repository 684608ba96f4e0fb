# SPDX-License-Identifier: BSD-3-Clause
"""Learning against plants that are simple enough to know what it must come to."""

import numpy as np
import pytest

from piezo_controller.learning.periodic_learner import PeriodicLearner

SAMPLE_PERIOD_S = 25e-6
PERIOD, PERIODS = 400, 5
REFERENCE_UM = 50.0 + 20.0 * np.sin(2 * np.pi * np.arange(PERIOD) / PERIOD)
NOISE_UM = 0.009


class Plant:
    """Follows reference plus correction, each harmonic with a gain and a disturbance of its own."""

    def __init__(self, gain, disturbance_um, drift_um_per_period=0.0, noise_um=NOISE_UM):
        self._gain, self._disturbance_um = gain, disturbance_um
        self._drift_um_per_period, self._noise_um = drift_um_per_period, noise_um
        self._generator = np.random.default_rng(1)

    def play(self, correction_um):
        """Return the displacement over some periods."""
        followed = np.fft.irfft(self._gain * np.fft.rfft(correction_um), PERIOD)
        period_um = REFERENCE_UM + self._disturbance_um + followed
        displacement_um = np.tile(period_um, PERIODS)
        displacement_um += self._drift_um_per_period * np.arange(displacement_um.size) / PERIOD
        return displacement_um + self._noise_um * self._generator.standard_normal(
            displacement_um.size)


def learner(response=1.0, effort=1.0, **options):
    return PeriodicLearner(REFERENCE_UM, lambda hz: np.full(hz.size, response),
                           lambda hz: np.full(hz.size, effort), SAMPLE_PERIOD_S, **options)


def disturbance(*parts):
    """Sum of (order, size in um, phase)."""
    angle = 2 * np.pi * np.arange(PERIOD) / PERIOD
    return sum(size * np.cos(order * angle + phase) for order, size, phase in parts)


DISTURBANCE_UM = disturbance((1, 1.0, 0.3), (3, 0.2, 1.0), (5, 0.05, 2.0))


def learn(learner, plant, most=20):
    """Return the errors (um) of the iterations until the learner has finished."""
    errors_um = []
    while not learner.finished and len(errors_um) < most:
        errors_um.append(learner.learn(plant.play(learner.correction_um)).rms_um)
    return errors_um


def test_measured_harmonics_are_those_of_the_error_without_drift_and_their_noise_is_told():
    plant = Plant(1.0, DISTURBANCE_UM, drift_um_per_period=0.3)
    measured = [learner().measure(plant.play(np.zeros(PERIOD))) for _ in range(50)]
    expected = np.zeros(25, dtype=complex)
    expected[[0, 2, 4]] = -1.0 * np.exp(0.3j), -0.2 * np.exp(1j), -0.05 * np.exp(2j)
    deviations = np.array([m.harmonics_um for m in measured]) - expected
    assert np.abs(deviations.mean(axis=0)).max() < 1e-3
    spread_um = np.sqrt(np.mean(np.abs(deviations) ** 2))
    assert spread_um == pytest.approx(2 * NOISE_UM / np.sqrt(PERIOD * PERIODS), rel=0.1)
    assert np.mean([m.noise_um for m in measured]) == pytest.approx(spread_um, rel=0.1)
    assert measured[0].rms_um == pytest.approx(np.std(DISTURBANCE_UM), rel=1e-2)


def test_with_the_right_response_one_iteration_is_enough_and_it_stops_at_the_noise_floor():
    gain = 0.7 * np.exp(0.4j)
    pupil = PeriodicLearner(REFERENCE_UM, lambda hz: np.full(hz.size, gain),
                            lambda hz: np.ones(hz.size), SAMPLE_PERIOD_S)
    errors_um = learn(pupil, Plant(gain, DISTURBANCE_UM))
    assert pupil.finished == "the noise floor is reached"
    assert len(errors_um) <= 3
    left_um = Plant(gain, DISTURBANCE_UM, noise_um=0.0).play(pupil.best_um)[:PERIOD] - REFERENCE_UM
    assert np.std(left_um) < 2.5e-3


@pytest.mark.parametrize("gain", [0.6, 1.6, np.exp(0.7j), 1.4 * np.exp(-0.5j)])
def test_response_that_was_expected_wrongly_is_learned_too(gain):
    pupil = learner()
    errors_um = learn(pupil, Plant(gain, DISTURBANCE_UM))
    assert pupil.finished == "the noise floor is reached"
    # A fixed step would take off no more than |1 - gain| each time.
    assert errors_um[3] < 0.3 * abs(1 - gain) ** 3 * errors_um[0]


def test_divergence_is_noticed_and_the_best_iterate_is_what_remains():
    plant = Plant(-1.0, DISTURBANCE_UM)
    pupil = learner()
    errors_um = learn(pupil, plant)
    assert pupil.finished
    assert max(errors_um) > 1.5 * errors_um[0]
    best = int(np.argmin(errors_um))
    assert pupil.best_rms_um == errors_um[best]
    left_um = Plant(-1.0, DISTURBANCE_UM, noise_um=0.0).play(pupil.best_um) - np.tile(
        REFERENCE_UM, PERIODS)
    assert np.std(left_um) == pytest.approx(errors_um[best], rel=0.02)


def test_error_that_does_not_answer_ends_the_learning():
    pupil = learner()
    learn(pupil, Plant(0.0, DISTURBANCE_UM))
    assert pupil.finished == "the error does not fall any more"
    assert pupil.iterations < 10


def test_harmonics_that_take_much_drive_and_that_the_reference_has_not_are_left_alone():
    plant = Plant(1.0, disturbance((1, 1.0, 0.0), (20, 0.01, 0.0)))
    costly = learner(effort=1.0)
    costly._effort = np.where(np.arange(1, 26) == 20, 1000.0, 1.0)
    learn(costly, plant)
    assert abs(costly._harmonics(costly.best_um)[19]) < 1e-12
    cheap = learner()
    learn(cheap, plant)
    assert abs(cheap._harmonics(cheap.best_um)[19]) == pytest.approx(0.01, rel=0.1)


def test_what_was_learned_is_a_beginning():
    plant = Plant(1.0, DISTURBANCE_UM)
    first = learner()
    learn(first, plant)
    second = learner(correction_um=first.best_um)
    np.testing.assert_allclose(second.correction_um, first.best_um, atol=1e-12)
    assert len(learn(second, plant)) <= 2 < len(learn(learner(response=0.5), plant))


def test_reference_without_a_harmonic_in_the_band_is_refused():
    with pytest.raises(ValueError, match="no harmonic that can be learned"):
        PeriodicLearner(np.zeros(10), np.ones_like, np.ones_like, SAMPLE_PERIOD_S)
