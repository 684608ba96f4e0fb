# SPDX-License-Identifier: BSD-3-Clause
"""A search in rows far between looks at the frequencies of the whole record."""

import numpy as np
import pytest
from scipy.signal import cont2discrete, dlsim

from piezo_identification.estimators.dynamics.fast_record import FastRecord
from piezo_identification.estimators.dynamics.pole_search import residual_peaks
from piezo_identification.estimators.poles.pole_responses import HeldInput

PERIOD_S, COUNT, MODE_RAD_PER_S = 1e-4, 12_000, 4660.0


@pytest.mark.parametrize("most_rows", [COUNT, 2000])
def test_what_is_left_peaks_at_the_mode_however_few_rows_are_fitted(most_rows):
    inputs = np.random.default_rng(2).normal(size=COUNT // 4).repeat(4)
    w, damping = MODE_RAD_PER_S, 0.01
    system = cont2discrete(([w * w], [1.0, 2.0 * damping * w, w * w]), PERIOD_S)
    output = dlsim((*system[:2], PERIOD_S), inputs)[1][:, 0]
    rows = np.arange(COUNT - 2)
    record = FastRecord(HeldInput(inputs, PERIOD_S, False), rows, output[rows],
                        np.ones((rows.size, 1)), lambda modes: []).thinned(most_rows)
    lag_alone = record.free(np.log([PERIOD_S]), 0.0)
    # The rows of every sixth sample show no frequency above 833 Hz / 2, this one at 742 Hz.
    assert np.allclose(residual_peaks(record, lag_alone), w, rtol=0.05)
