# SPDX-License-Identifier: BSD-3-Clause
"""Identification of a flexure that is softer the harder it is driven, from periods at levels."""

import sys
from pathlib import Path

import numpy as np
import pytest

from piezo_identification.axes.identify_axes import identify_several_axes
from piezo_identification.axes.predict_axes import predict_several_axes
from piezo_identification.axes.spectra import levels_of, spectra_of_level
from piezo_recorder.reading.axes import axes_recordings_of_arrays

sys.path.insert(0, str(Path(__file__).parent))
import flexure


def recordings(realisations, seed):
    return [each for voltage_v, displacement_um in flexure.periods(realisations, seed)
            for each in axes_recordings_of_arrays(
                voltage_v, displacement_um, 1.0 / flexure.PERIOD_S, ("x", "y"),
                ("sample", "channel", "realisation", "period"))]


@pytest.fixture(scope="module")
def fitted():
    return recordings(4, 3)


@pytest.fixture(scope="module")
def identified(fitted):
    return identify_several_axes(fitted, pairs=4)


def test_levels_are_told_apart_by_their_amplitude(fitted):
    levels = levels_of(fitted)
    assert [len(level) for level in levels] == [4, 4, 4]
    np.testing.assert_allclose([level[0].amplitude_v for level in levels], flexure.LEVELS_V,
                               rtol=0.01)


def test_the_response_of_a_level_has_the_deviation_of_its_noise(fitted):
    spectra = spectra_of_level(levels_of(fitted)[0])
    frequency_hz = np.angle(spectra[0].z) / (2.0 * np.pi * flexure.PERIOD_S)
    true = flexure.response(frequency_hz, flexure.SOFTER[0], flexure.DAMPED[0])
    for axis, spectrum in enumerate(spectra):
        errors = np.abs(spectrum.weight * (spectrum.motion - true[:, :, axis])) ** 2
        assert 0.7 < np.mean(errors) < 1.6


def test_one_model_predicts_all_levels_to_three_times_the_noise(identified):
    for unseen in recordings(1, 11):
        prediction = predict_several_axes(identified.model, unseen)
        left_um = prediction.measured_um - prediction.simulated_um
        assert np.all(np.std(left_um, axis=0) < 3.0 * flexure.NOISE_UM)


def test_what_softens_is_named(identified):
    sentences = " ".join(identified.softening_sentences())
    assert "amplitude-dependent stiffness" in sentences
    assert "amplitude-dependent damping" in sentences
    for frequency in flexure.FREQUENCY_RAD_PER_S:
        stiff, soft = (identified.model.mode_near(frequency / (2.0 * np.pi), level_v)
                       for level_v in (flexure.LEVELS_V[0], flexure.LEVELS_V[2]))
        # To 10 % of the change, as the entries of the coupling.
        assert abs(soft) / abs(stiff) - 1.0 == pytest.approx(
            np.sqrt(flexure.SOFTER[2]) - 1.0, rel=0.1)


def test_the_model_interpolates_between_levels(identified):
    for frequency in flexure.FREQUENCY_RAD_PER_S:
        ratio = abs(identified.model.mode_near(frequency / (2.0 * np.pi), 2.5)) / frequency
        assert np.sqrt(flexure.SOFTER[2]) < ratio < np.sqrt(flexure.SOFTER[1])


def test_of_one_level_no_softening_is_sought(fitted):
    notes = []
    identified = identify_several_axes(
        levels_of(fitted)[0], pairs=len(flexure.FREQUENCY_RAD_PER_S), note=notes.append)
    assert identified.model.latency_samples.any()
    assert identified.model.softening is None
    assert not any("amplitude" in note for note in notes)
