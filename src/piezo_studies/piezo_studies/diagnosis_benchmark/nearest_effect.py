# SPDX-License-Identifier: BSD-3-Clause
"""What a named effect should be found to be where the hidden one has another form.

A play that sets in softly has no width that a hard one shares, and a hum whose phase wanders has
another frequency in each recording. Estimates of a form that is not exactly right tend to that of
its members which comes nearest (White, Maximum likelihood estimation of misspecified models,
Econometrica 50, 1982); so that is what intervals should contain.
"""

import numpy as np
from scipy.optimize import least_squares

from piezo_models.effects import fitted_values, with_fitted_values


def nearest_parameters(effect, without_um, added_um, sample_period_s, regression):
    """Return the parameters with which an effect comes nearest to what a hidden one adds.

    The plant is known here, and there is no noise: neither the errors of a model nor those of a
    fit to noise are in them.

    Parameters
    ----------
    effect : piezo_models.effects.effect.Effect
        Behind the stage, of the form that is named; the search begins from it.
    without_um, added_um : (N,) array
        Response of the plant without the hidden effect, and what that adds.
    regression : Regression
        Whose rows, weights and regressors count: of one recording of these samples.
    """
    rows, = regression.dataset.rows
    values, low, high = fitted_values(effect, regression.dataset.extent)

    def left(numbers):
        tried = with_fitted_values(effect, numbers)
        missing_um = added_um + without_um - tried.apply(without_um, sample_period_s)
        return regression.remainder(missing_um[rows] / regression.tolerance_um)

    solution = least_squares(left, np.clip(values, low, high), bounds=(low, high), x_scale="jac")
    return with_fitted_values(effect, solution.x).parameters()
