# SPDX-License-Identifier: BSD-3-Clause
"""Section 2.2.4: a constant density from one sine, by projection, by SVD, and by SVD updates."""

from dataclasses import dataclass
from functools import cache

import numpy as np

from piezo_common.picture_style import BLUE, label, new_figure
from piezo_studies.baselines.relay_regression import NormalEquations, projection, relay_rows
from piezo_studies.baselines.svd_estimate import truncated_svd
from piezo_studies.thesis.figure_table import Row, Study
from piezo_studies.thesis.pictures import draw_plane

LEVELS = 50
HIGHEST_V = 10.0
DENSITY = 4.0
NOISE_UM = 0.01
SAMPLES = 4000
SAMPLE_PERIOD_S = 1e-3
RANK = 64
NEW_POINTS = 50
UNSEEN_POINTS = 500
SECTION = "2.2.4"


def input_v(time_s):
    """Return the sine of the thesis, read as 5 (1 - cos 5 t): it spans the plane from 0 to 10 V."""
    return 0.5 * HIGHEST_V * (1.0 - np.cos(5.0 * time_s))


@dataclass(frozen=True)
class OneSine:
    """The samples, and properties of the Preisach plane."""

    levels_v: np.ndarray
    """Shape (L + 1,)."""
    rows: np.ndarray
    output_um: np.ndarray
    """Regression and noisy output of the relays, (N, n)."""
    area_v2: np.ndarray
    """Area s of each cell, (n,); half on the diagonal."""
    inner: np.ndarray
    """True for cells off the diagonal, (n,)."""
    equations: NormalEquations
    """Normal equations of the samples before the update."""
    unseen: np.ndarray
    """Regression for other inputs, (K, n)."""

    def density_error(self, weights_um):
        """Return the norm (2.26) of the density's error, absolute and relative in percent.

        The diagonal is excluded, as only then the density has the norm of 140 that the figures of
        the thesis imply.
        """
        error = (weights_um / self.area_v2 - DENSITY)[self.inner]
        norm = DENSITY * np.sqrt(np.count_nonzero(self.inner))
        return float(np.linalg.norm(error)), float(100.0 * np.linalg.norm(error) / norm)

    def output_error_um(self, weights_um):
        """Return the RMS error of the output for unseen inputs."""
        return float(np.sqrt(np.mean((self.unseen @ (weights_um - DENSITY * self.area_v2)) ** 2)))


@cache
def one_sine():
    """Simulate the samples; those for the update are last."""
    levels_v = np.linspace(0.0, HIGHEST_V, LEVELS + 1)
    time_s = np.arange(SAMPLES) * SAMPLE_PERIOD_S
    # The new points have other amplitudes, as points on the same loop would add no information.
    generator = np.random.default_rng(1)
    new_v = generator.uniform(0.0, HIGHEST_V, NEW_POINTS)
    rows = relay_rows(np.concatenate([input_v(time_s), new_v]), levels_v)
    i, j = np.tril_indices(LEVELS)
    area_v2 = (HIGHEST_V / LEVELS) ** 2 * np.where(i == j, 0.5, 1.0)
    output_um = rows @ (DENSITY * area_v2) + NOISE_UM * generator.standard_normal(len(rows))
    equations = NormalEquations(i.size)
    equations.add(rows[:SAMPLES], output_um[:SAMPLES])
    unseen = relay_rows(generator.uniform(0.0, HIGHEST_V, UNSEEN_POINTS), levels_v)
    return OneSine(levels_v, rows, output_um, area_v2, i != j, equations, unseen)


def study():
    """Compute the errors of the three estimates, and the rank."""
    data = one_sine()
    decomposition = truncated_svd(data.equations, rank=RANK)
    values = decomposition.all_singular_values
    full_rank = int(np.linalg.matrix_rank(np.diag(values), hermitian=True))
    projected, slow = (
        projection(data.rows[:SAMPLES], data.output_um[:SAMPLES], gain) for gain in (0.5, 0.001)
    )
    estimate = decomposition.solution()
    fixed = updated_estimates(data, decomposition, fixed_rank=True)
    growing = updated_estimates(
        data, truncated_svd(data.equations, rank=full_rank), fixed_rank=False
    )
    (projection_norm, projection_percent), (svd_norm, svd_percent) = (
        data.density_error(weights) for weights in (projected, estimate)
    )
    rows = [
        Row(SECTION, "rank of M", 99, full_rank, "1"),
        Row(SECTION, "singular values above 0.001 of the largest", 64,
            int(np.count_nonzero(values > 1e-3 * values[0])), "1",
            "does not come out; the 64 of the thesis are kept below"),
        Row(SECTION, "singular value 65 over the largest", 1e-3, values[RANK] / values[0], "1"),
        Row(SECTION, "density error, projection", 128.3, projection_norm, "um/V^2",
            "without the diagonal: only then is the density's norm the thesis' 140"),
        Row(SECTION, "density error, projection, relative", 91.6, projection_percent, "%",
            "gain 0.5, floor 1: the thesis gives neither"),
        Row(SECTION, "density error, projection, gain 0.001", 91.6, data.density_error(slow)[1],
            "%", "the error depends on the gain"),
        Row(SECTION, "density error, SVD, r = 64", 6.67, svd_norm, "um/V^2",
            "without the diagonal"),
        Row(SECTION, "density error, SVD, r = 64, relative", 4.7, svd_percent, "%"),
        Row(SECTION, "density error after 50 new points, r = 64", 5.9,
            data.density_error(fixed[-1])[0], "um/V^2",
            "does not fall: 64 directions cannot hold what new points add"),
        Row(SECTION, "output error on unseen input, before new points", None,
            data.output_error_um(growing[0]), "um", "all 99 directions kept"),
        Row(SECTION, "output error on unseen input, after 50 new points", None,
            data.output_error_um(growing[-1]), "um",
            "with one more direction for each new point: updating improves this"),
    ]
    return Study(rows, {
        "2.2": _draw_errors(data, projected, estimate),
        "2.3": _draw_updating(*(
            [data.output_error_um(weights) for weights in estimates]
            for estimates in (fixed, growing)
        )),
    })


def updated_estimates(data, decomposition, fixed_rank):
    """Return the estimates before and after each of the new points."""
    estimates = [decomposition.solution()]
    for row, output in zip(data.rows[SAMPLES:], data.output_um[SAMPLES:], strict=True):
        decomposition = decomposition.updated(row, output, fixed_rank)
        estimates.append(decomposition.solution())
    return estimates


def _draw_errors(data, *estimates):
    figure = new_figure(2.6)
    for axes, name, weights_um in zip(
        figure.subplots(1, 2), ("projection", "truncated SVD"), estimates, strict=True
    ):
        error = np.full((LEVELS, LEVELS), np.nan)
        error[np.tril_indices(LEVELS)] = weights_um / data.area_v2 - DENSITY
        np.fill_diagonal(error, np.nan)
        draw_plane(figure, axes, data.levels_v, error, "error (um/V²)")
        axes.set_title(name, size="medium")
    return figure


def _draw_updating(fixed_um, growing_um):
    figure = new_figure(3.2)
    axes = figure.subplots()
    axes.plot(fixed_um, color="0.4", linestyle="--", label="64 directions, as in the thesis")
    axes.plot(growing_um, color=BLUE, label="99 directions and more")
    axes.set_ylim(bottom=0.0)
    axes.legend()
    label(axes, "number of new points", "output error on unseen input (um)")
    return figure
