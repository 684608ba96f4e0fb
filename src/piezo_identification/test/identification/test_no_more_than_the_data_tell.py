# SPDX-License-Identifier: BSD-3-Clause
"""Two tanks in series, whose outflow goes by the root of their level: no model is of that form.

A model of many modes and a hysteresis follows the levels that it was fitted to, and no others.
"""

import numpy as np
import pytest

from piezo_identification import identify
from piezo_identification.prediction import predict
from piezo_recorder import recording_of

PERIOD_S, SAMPLES, STEPS, NOISE = 4.0, 1000, 8, 0.02
INFLOW, OUTFLOW = 0.03, 0.05


def recording(seed):
    """Return the level of the second tank beside the voltage of the pump."""
    generator = np.random.default_rng(seed)
    voltage_v = np.convolve(generator.normal(size=SAMPLES), np.hanning(40), mode="same")
    voltage_v = 3.0 + 1.2 * voltage_v / voltage_v.std()
    first = second = 4.0
    level = np.empty(SAMPLES)
    for n, inflow in enumerate(voltage_v.clip(0.0)):
        level[n] = second
        for _ in range(STEPS):
            between = OUTFLOW * np.sqrt(max(first, 0.0))
            first += PERIOD_S / STEPS * (INFLOW * inflow - between)
            second += PERIOD_S / STEPS * (between - OUTFLOW * np.sqrt(max(second, 0.0)))
    return recording_of({
        "time_s": PERIOD_S * np.arange(SAMPLES), "voltage_v": voltage_v,
        "displacement_um": level + NOISE * generator.normal(size=SAMPLES)})


def error_of_best_lags(fitted, unseen):
    """Return what is left of another recording by the best two lags, in parts of its motion."""
    def behind_lags(given, lag_s):
        kept, out = np.exp(-PERIOD_S / lag_s), np.asarray(given.voltage_v) - 3.0
        for _ in range(2):
            state, now = 0.0, np.empty(out.size)
            for n, value in enumerate(out):
                state = kept * state + (1.0 - kept) * value
                now[n] = state
            out = now
        return out[SAMPLES // 4 :]

    def fit(lag_s):
        moved = np.column_stack([behind_lags(fitted, lag_s), np.ones(SAMPLES - SAMPLES // 4)])
        measured = fitted.displacement_um[SAMPLES // 4 :]
        sizes = np.linalg.lstsq(moved, measured, rcond=None)[0]
        return np.std(measured - moved @ sizes), lag_s, sizes[0]

    _, lag_s, gain = min(fit(lag_s) for lag_s in np.geomspace(5.0, 200.0, 60))
    measured = unseen.displacement_um[SAMPLES // 4 :]
    return np.std(measured - gain * behind_lags(unseen, lag_s)) / np.std(measured)


@pytest.mark.long
def test_unseen_levels_are_predicted_as_well_as_by_the_best_two_lags():
    unseen = recording(2)
    prediction = predict(identify(dynamics=recording(1)).model, unseen)
    assert prediction.e_y_percent() < 110.0 * error_of_best_lags(recording(1), unseen)
