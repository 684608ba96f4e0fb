# SPDX-License-Identifier: BSD-3-Clause
"""The expected parameters of a named effect if the hidden one has another form.

A play with a gradual onset has no width comparable to that of a hard play, and hum with a wandering
phase has a different frequency in each recording. Estimates with a misspecified model converge to
its nearest member (White, Maximum likelihood estimation of misspecified models, Econometrica 50,
1982). Intervals should therefore contain the parameters of that member.
"""

import numpy as np
from scipy.optimize import least_squares

from piezo_models.effects import fitted_values, with_fitted_values


def nearest_parameters(effect, without_um, added_um, sample_period_s, regression):
    """Return the parameters with which an effect approximates a hidden one best.

    The plant is known and free of noise, so the parameters contain neither model errors nor errors
    from fitting noise.

    Parameters
    ----------
    effect : piezo_models.effects.effect.Effect
        Effect of the named form, which acts after the stage; the search begins with it.
    without_um, added_um : (N,) array
        Response of the plant without the hidden effect, and the contribution of that effect.
    regression : Regression
        Regression on one recording of these samples, which gives rows, weights and regressors.
    """
    rows, = regression.dataset.rows
    values, low, high = fitted_values(effect, regression.dataset.extent)

    def error(numbers):
        tried = with_fitted_values(effect, numbers)
        missing_um = added_um + without_um - tried.apply(without_um, sample_period_s)
        return regression.remainder(missing_um[rows] / regression.tolerance_um)

    solution = least_squares(error, np.clip(values, low, high), bounds=(low, high), x_scale="jac")
    return with_fitted_values(effect, solution.x).parameters()
