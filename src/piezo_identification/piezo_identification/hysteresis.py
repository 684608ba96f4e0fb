# SPDX-License-Identifier: BSD-3-Clause
"""Preisach density from harmonics of stair amplitude, by smoothed non-negative least squares."""

import numpy as np
from scipy.sparse import coo_array

from piezo_identification.dynamics import remove_creep
from piezo_identification.nonnegative import nonnegative_minimum
from piezo_identification.settling import low_frequency_delay_s, settling_time_s
from piezo_identification.waveforms import played, sample_by_voltage
from piezo_models.preisach import PreisachModel
from piezo_models.relay_grid import activation_matrix

SMOOTHING_WEIGHTS = (0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0)
"""Weights of the density's second differences, tried in this order on samples held out."""

ROWS_AT_ONCE = 500
"""Rows of the regression on the fine grid that are held in memory together."""


def estimate_hysteresis(
    recording, creep, dynamics, level_count=70, cells_per_level=2, smoothing_weight=None
):
    """Estimate the Preisach density on a uniform grid over the voltages played.

    Creep and fast dynamics are taken off by their inverses, Fig. 4.8; the samples of the rule
    (4.9)-(4.10) make a linear regression (4.11). Its unknowns are the densities at the crossings
    of the levels, linear in between: a density constant between levels would make scallops of a
    straight branch. They are nowhere negative, and their second differences along both thresholds
    are kept small. Offset and initial creep are free.

    Parameters
    ----------
    recording : Recording
        Of the hysteresis experiment; what precedes its lowest voltage is not used.
    creep : CreepDynamics
    dynamics : ElectricVibrationDynamics
    level_count : int
        Number of levels L above level 0.
    cells_per_level : int
        Cells of the model from one level to the next.
    smoothing_weight : float, optional
        By default the one of `SMOOTHING_WEIGHTS` after which the samples halfway between the
        levels, which are not fitted, are predicted worse.

    Returns
    -------
    PreisachModel

    Raises
    ------
    ValueError
        If the recording has gaps, its voltage does not pass by all levels, or the displacement
        falls where the voltage rises.
    """
    part = _from_lowest_voltage(played(recording))
    voltage_v = part.voltage_v
    lowest_v, highest_v = voltage_v.min(), voltage_v.max()
    levels_v = np.linspace(lowest_v, highest_v, level_count + 1)
    samples = sample_by_voltage(voltage_v, levels_v)
    _check_coverage(recording.path, part, samples, levels_v)
    edges_v = np.linspace(lowest_v, highest_v, level_count * cells_per_level + 1)
    # Unknowns of the size of a displacement: density times the area between levels.
    area_v2 = (levels_v[1] - levels_v[0]) ** 2
    interpolation = density_interpolation(level_count, cells_per_level)
    output_um = hysteresis_output_um(part, creep, dynamics)
    initial_creep = np.exp(-np.outer(part.time_s, creep.zeros_rad_per_s))
    free = 1 + initial_creep.shape[1]
    settling_s = settling_time_s(dynamics)

    def regression(samples):
        """Columns for the densities, the offset and the initial creep; and what they explain."""
        samples = samples[part.time_s[samples] >= settling_s]
        matrix = np.empty((samples.size, interpolation.shape[1] + free))
        for start in range(0, samples.size, ROWS_AT_ONCE):
            rows = slice(start, start + ROWS_AT_ONCE)
            active_v2 = activation_matrix(voltage_v, edges_v, samples[rows])
            matrix[rows, :-free] = active_v2 @ interpolation / area_v2
        matrix[:, -free] = 1.0
        matrix[:, interpolation.shape[1] + 1 :] = initial_creep[samples]
        return matrix, output_um[samples]

    matrix, target_um = regression(samples)
    normal, linear = matrix.T @ matrix, matrix.T @ target_um
    # Far below the data, it only keeps creep transients apart that the record cannot tell apart.
    normal[np.diag_indices_from(normal)] += 1e-12 * np.trace(normal) / normal.shape[0]
    roughness = np.zeros_like(normal)
    roughness[:-free, :-free] = _roughness(level_count)

    def solve(weight):
        return nonnegative_minimum(normal + weight**2 * roughness, linear, free)

    if smoothing_weight is not None:
        solution = solve(smoothing_weight)
    else:
        unseen, unseen_um = regression(
            sample_by_voltage(voltage_v, 0.5 * (levels_v[:-1] + levels_v[1:]))
        )
        least = np.inf
        for trial in map(solve, SMOOTHING_WEIGHTS):
            error = np.sum((unseen @ trial - unseen_um) ** 2)
            if error > least:
                break
            solution, least = trial, error
    density = np.zeros((edges_v.size - 1, edges_v.size - 1))
    density[np.tril_indices_from(density)] = interpolation @ solution[:-free] / area_v2
    return PreisachModel(lowest_v, highest_v, density, float(solution[-free]))


def hysteresis_output_um(recording, creep, dynamics):
    """Hysteresis output at each sample: creep, electric and vibration dynamics taken off.

    Parameters
    ----------
    recording : Recording
        Of a voltage that is slow beside the electric and vibration dynamics.
    creep : CreepDynamics
    dynamics : ElectricVibrationDynamics
        Inverted at low frequency, (4.18) and (4.19).

    Returns
    -------
    ndarray, shape (N,)
        But for the decaying trace of the creep's initial state.
    """
    displacement_um = recording.displacement_um
    if dynamics.is_static:
        return remove_creep(displacement_um, creep, recording.sample_period_s)
    # The hold lags half a sample, the mean leads half a sample less half a clock period.
    lead_s = low_frequency_delay_s(dynamics) + 0.5 / recording.sample_rate_hz
    slope_um_per_s = np.gradient(displacement_um, recording.sample_period_s)
    return remove_creep(displacement_um + lead_s * slope_um_per_s, creep, recording.sample_period_s)


def density_interpolation(level_count, cells_per_level):
    """Densities of the cells from those at the crossings of the levels, linear in between.

    Parameters
    ----------
    level_count, cells_per_level : int

    Returns
    -------
    coo_array, shape (cells, crossings)
        Rows and columns i-major with j <= i; a row sums to one.
    """
    rows, columns = np.tril_indices(level_count * cells_per_level)
    # A cell on the diagonal is a triangle, whose centroid lies aside.
    aside = np.where(rows == columns, 1.0 / 6.0, 0.0)
    alpha = (rows + 0.5 + aside) / cells_per_level
    beta = (columns + 0.5 - aside) / cells_per_level
    i, j = alpha.astype(int), beta.astype(int)
    s, t = alpha - i, beta - j
    triangle = i == j
    corners = (
        (i, j, np.where(triangle, 1.0 - s, (1.0 - s) * (1.0 - t))),
        (i + 1, j, np.where(triangle, s - t, s * (1.0 - t))),
        (i + 1, j + 1, np.where(triangle, t, s * t)),
        (i, np.where(triangle, j, j + 1), np.where(triangle, 0.0, (1.0 - s) * t)),
    )
    cells = np.arange(rows.size)
    return coo_array(
        (
            np.concatenate([weight for *_, weight in corners]),
            (
                np.tile(cells, len(corners)),
                np.concatenate([a * (a + 1) // 2 + b for a, b, _ in corners]),
            ),
        ),
        shape=(rows.size, (level_count + 1) * (level_count + 2) // 2),
    ).tocsr()


def _from_lowest_voltage(part):
    """The part from the first sample at negative saturation, where the memory is known."""
    voltage_v = part.voltage_v
    near_v = voltage_v.min() + 1e-3 * np.ptp(voltage_v)
    return part.select(np.arange(voltage_v.size) >= np.argmax(voltage_v <= near_v))


def _check_coverage(path, part, samples, levels_v):
    """Refuse a voltage that says nothing about most of the Preisach plane."""
    spacing_v = levels_v[1] - levels_v[0]
    passed = np.unique(np.round((part.voltage_v[samples] - levels_v[0]) / max(spacing_v, 1e-12)))
    if passed.size < 0.9 * levels_v.size:
        raise ValueError(
            f"{path} passes by {passed.size} of {levels_v.size} voltage levels: "
            "give a hysteresis experiment, whose voltage changes slowly"
        )
    rise_um = np.polyfit(part.voltage_v[samples], part.displacement_um[samples], 1)[0]
    if rise_um <= 0.0:
        raise ValueError(
            f"{path}: the displacement falls where the voltage rises: reverse the sign of one"
        )


def _roughness(level_count):
    """Sum of squares of the second differences along both thresholds, as a quadratic form."""
    size = level_count + 1
    number = np.full((size, size), -1)
    crossings = np.tril_indices(size)
    number[crossings] = np.arange(crossings[0].size)
    triples = np.concatenate([
        np.stack([number[:, :-2], number[:, 1:-1], number[:, 2:]], axis=-1).reshape(-1, 3),
        np.stack([number[:-2], number[1:-1], number[2:]], axis=-1).reshape(-1, 3),
    ])
    triples = triples[(triples >= 0).all(axis=1)]
    rows = np.repeat(np.arange(len(triples)), 3)
    values = np.tile([1.0, -2.0, 1.0], len(triples))
    differences = coo_array(
        (values, (rows, triples.ravel())), shape=(len(triples), number.max() + 1)
    )
    return (differences.T @ differences).toarray()
