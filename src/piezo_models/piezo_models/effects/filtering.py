# SPDX-License-Identifier: BSD-3-Clause
"""Linear filters on sampled displacements, which are straight between samples, not held."""

import numpy as np
from scipy.signal import cont2discrete, lfilter, lfilter_zi


def filtered(numerator, denominator, signal, sample_period_s, rest=None):
    """Signal behind a continuous transfer function, from rest.

    Parameters
    ----------
    numerator, denominator : sequence of float
        Of the powers of s, the highest first.
    signal : (N,) array
        Taken as straight between samples.
    sample_period_s : float
    rest : float, optional
        Level at which the signal has rested before; its first value by default.

    Returns
    -------
    (N,) array
    """
    b, a, _ = cont2discrete((numerator, denominator), sample_period_s, method="foh")
    b = np.ravel(b)
    rest = float(signal[0]) if rest is None else rest
    return lfilter(b, a, signal, zi=lfilter_zi(b, a) * rest)[0]
