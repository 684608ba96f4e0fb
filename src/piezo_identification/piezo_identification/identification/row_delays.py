# SPDX-License-Identifier: BSD-3-Clause
"""When the rows of every recording are read, and what delay the model leaves in it."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from piezo_identification.conditioning.row_alignment import RowDelay, remaining_delay
from piezo_identification.estimators.estimate import DelayEstimate
from piezo_identification.estimators.frequency_response.response_file import FrequencyResponse
from piezo_identification.identification.linear_dynamics import LinearDynamics, read_as
from piezo_identification.prediction.model_run import ModelRun
from piezo_models.cascade import StageModel


def row_delays(
    model: StageModel, recordings: Mapping[str, Any], found: Mapping[str, float],
    read_at_samples: float, linear: LinearDynamics,
) -> dict[str, RowDelay]:
    """Estimate what is left of the delay of every recording.

    Parameters
    ----------
    model : StageModel
    recordings : dict of str to Recording or FrequencyResponse
        Aligned.
    found : dict of str to float
        Instants at which rows are read that were found, in sample periods.
    read_at_samples : float
        What was said of them before.
    linear : LinearDynamics

    Returns
    -------
    dict of str to RowDelay
        Of the recordings of samples.
    """
    rows = {}
    for name, recording in recordings.items():
        if isinstance(recording, FrequencyResponse):
            continue
        read_at = read_as(recording, read_at_samples + found[name])
        estimate = linear.estimates.get(name)
        if estimate is not None and estimate.delay is not None:
            delay = estimate.delay
            left_s = 0.0 if delay.is_significant else delay.delay_s
            rows[name] = RowDelay(read_at, left_s, delay.standard_deviation_s)
            continue
        run = ModelRun(model, recording)
        good = run.good
        rows[name] = RowDelay(read_at, *remaining_delay(
            run.measured_um[good], run.simulated_um(())[good], run.part.sample_period_s,
            np.ones((np.count_nonzero(good), 1))))
    return rows


def tell_row_delays(rows: Mapping[str, RowDelay], tell: Callable[[str], object]) -> None:
    """Tell when the rows of each recording are read, and what delay is left in it."""
    for name, row in rows.items():
        delay = DelayEstimate(row.delay_s, row.standard_deviation_s, 1.0)
        verdict = "significant" if delay.is_significant else "not significant"
        tell(f"rows of the {name}: read {row.read_at_samples:.4g} sample periods after their "
             f"voltage; a delay of {1e6 * row.delay_s:.4g} +- "
             f"{1e6 * row.standard_deviation_s:.2g} us is left, which is {verdict}")
