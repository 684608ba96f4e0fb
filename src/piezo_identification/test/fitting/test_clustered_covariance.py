# SPDX-License-Identifier: BSD-3-Clause
"""The stated covariance against the scatter of fits to many drawn records."""

import numpy as np
import pytest

from piezo_identification.fitting.clustered_covariance import (
    clustered_covariance,
    jackknife_variances,
)

CLUSTERS, ROWS = 60, 20


@pytest.mark.parametrize("alike", [False, True])
def test_it_is_the_scatter_of_fits_to_errors_that_are_alike(alike):
    generator = np.random.default_rng(4)
    cluster = np.repeat(np.arange(CLUSTERS), ROWS)
    columns = np.column_stack([
        np.ones(cluster.size), np.repeat(generator.normal(size=CLUSTERS), ROWS)])
    found, stated = [], []
    for _ in range(300):
        errors = generator.normal(size=cluster.size)
        if alike:
            errors = 0.6 * errors + np.repeat(generator.normal(size=CLUSTERS), ROWS)
        sizes = np.linalg.lstsq(columns, errors, rcond=None)[0]
        found.append(sizes)
        stated.append(np.diag(clustered_covariance(-columns, errors - columns @ sizes, cluster)))
    np.testing.assert_allclose(np.mean(stated, axis=0), np.var(found, axis=0), rtol=0.25)


def test_errors_that_are_alike_for_longer_than_a_cluster_widen_it():
    generator = np.random.default_rng(6)
    cluster = np.repeat(np.arange(200), ROWS)
    columns = np.ones((cluster.size, 1))
    found, stated = [], []
    for _ in range(200):
        errors = np.repeat(generator.normal(size=20), 10 * ROWS)
        found.append(errors.mean())
        stated.append(clustered_covariance(-columns, errors - found[-1], cluster)[0, 0])
    assert np.mean(stated) == pytest.approx(np.var(found), rel=0.25)


def test_recordings_that_contradict_each_other_widen_it_though_they_are_few():
    generator = np.random.default_rng(8)
    recording = np.repeat(np.arange(4), 50 * ROWS)
    voltage = generator.normal(size=recording.size)
    columns = np.column_stack([voltage, np.ones(recording.size)])
    found, stated = [], []
    for _ in range(300):
        gains = 1.0 + 0.1 * generator.normal(size=4)
        motion = gains[recording] * voltage + 0.1 * generator.normal(size=recording.size)
        sizes = np.linalg.lstsq(columns, motion, rcond=None)[0]
        residual = motion - columns @ sizes
        found.append(sizes[0])
        with_prior = np.vstack([-columns, 1e-6 * np.eye(2)]), np.append(residual, [0.0, 0.0])
        stated.append(jackknife_variances(*with_prior, recording)[0])
    assert np.mean(stated) == pytest.approx(np.var(found), rel=0.25)
