# SPDX-License-Identifier: BSD-3-Clause
"""Fit a public library's model to records: python peer_dynamics.py METHOD RECORDS.npz RESULT.json.

Runs in the environment of the peers, which are called as their own documentation tells. All are
told the true order of the plant and that the output answers one sample later.
"""

import json
import sys
import time
import warnings
from functools import partial
from importlib.metadata import version
from pathlib import Path

import numpy as np

ORDER = 3
BLOCK_ROWS = 20
"""Of the subspace methods; what SIPPY takes by default."""


def sippy(method, options, input, output, sample_period_s):
    """SIPPY: numerator and denominator, or matrices of the state space."""
    from sippy_unipi import system_identification

    model = system_identification(output, input, method, tsample=sample_period_s, **options)
    if method == "N4SID":
        return model.A, model.B, model.C, model.D
    return model.G.num[0][0], model.G.den[0][0]


def pysib(estimator, orders, input, output, sample_period_s):
    """Return the polynomials B and A F of pysib, filled up to equal length."""
    import pysib

    _, model = getattr(pysib, estimator)(input, output, *orders, 1)
    return _of_shift(model["B"], np.convolve(model["A"], model["F"]))


def nfoursid(input, output, sample_period_s):
    """Return the matrices of the state space of nfoursid."""
    import pandas
    from nfoursid.nfoursid import NFourSID

    frame = pandas.DataFrame({"input": input, "output": output})
    method = NFourSID(frame, ["output"], ["input"], num_block_rows=BLOCK_ROWS)
    method.subspace_identification()
    model, _ = method.system_identification(rank=ORDER)
    return model.a, model.b, model.c, model.d


def sysidentpy(unbiased, input, output, sample_period_s):
    """SysIdentPy: its NARX of degree 1 is linear; unbiased is by extended least squares."""
    from sysidentpy.basis_function import Polynomial
    from sysidentpy.model_structure_selection import FROLS
    from sysidentpy.parameter_estimation import LeastSquares

    model = FROLS(
        order_selection=False, n_terms=2 * ORDER, xlag=ORDER, ylag=ORDER,
        estimator=LeastSquares(unbiased=unbiased), basis_function=Polynomial(degree=1))
    model.fit(X=input[:, None], y=output[:, None])
    numerator, denominator = np.zeros(ORDER + 1), np.eye(ORDER + 1)[0]
    for (code,), value in zip(model.final_model, model.theta.ravel(), strict=True):
        # A regressor is coded as 1000 times the signal, the output first, plus its lag.
        signal, lag = divmod(int(code), 1000)
        if signal == 1:
            denominator[lag] = -value
        elif signal == 2:
            numerator[lag] = value
    return numerator, denominator


ARMAX = dict(ARMAX_orders=[ORDER, ORDER, ORDER, 0])
METHODS = {
    "SIPPY ARMAX": partial(sippy, "ARMAX", ARMAX),
    "SIPPY ARMAX, optimised": partial(sippy, "ARMAX", ARMAX | dict(ARMAX_mod="OPT")),
    "SIPPY N4SID": partial(sippy, "N4SID", dict(SS_fixed_order=ORDER, SS_f=BLOCK_ROWS)),
    "pysib ARMAX": partial(pysib, "armax", (ORDER, ORDER, ORDER)),
    "pysib ARMAX, filtered": partial(pysib, "armax_filtered", (ORDER, ORDER, ORDER)),
    "pysib output error": partial(pysib, "oe", (ORDER, ORDER)),
    "nfoursid N4SID": nfoursid,
    "SysIdentPy ARX": partial(sysidentpy, False),
    "SysIdentPy ARMAX": partial(sysidentpy, True),
}
PACKAGES = {"SIPPY": "sippy_unipi", "pysib": "pysib", "nfoursid": "nfoursid",
            "SysIdentPy": "sysidentpy"}


def response(model, frequency_hz, sample_period_s):
    """Complex response of a model as the methods give it, in the shape of the frequencies."""
    z = np.exp(2j * np.pi * frequency_hz * sample_period_s)
    if len(model) == 2:
        return np.polyval(model[0], z) / np.polyval(model[1], z)
    a, b, c, d = map(np.asarray, model)
    return np.array([(c @ np.linalg.solve(x * np.eye(len(a)) - a, b) + d).item() for x in z])


def fit_all(method, records, time_limit_s):
    """Return responses and times of the records, until the time is over.

    Each fit has "time_s", and either "response" (real and imaginary parts) or "error".
    """
    input, frequency_hz = records["input"], records["frequency_hz"]
    sample_period_s = float(records["sample_period_s"])
    fits, begin_s = [], time.perf_counter()
    for output in records["outputs"]:
        start_s = time.perf_counter()
        if start_s - begin_s > time_limit_s:
            break
        try:
            model = method(input, output, sample_period_s)
            fit = {"time_s": time.perf_counter() - start_s}
            values = response(model, frequency_hz, sample_period_s)
            fit["response"] = [values.real.tolist(), values.imag.tolist()]
        except Exception as error:  # whatever a library raises is its result
            fit = {"time_s": time.perf_counter() - start_s, "error": repr(error)}
        fits.append(fit)
    return fits


def _of_shift(numerator, denominator):
    """Polynomials in the shift to earlier samples, filled up to be polynomials in z."""
    size = max(len(numerator), len(denominator))
    return [np.pad(p, (0, size - len(p))) for p in (numerator, denominator)]


def main():
    """Fit and write."""
    name, records, result = sys.argv[1:]
    warnings.simplefilter("ignore")
    with np.load(records) as archive:
        records = dict(archive)
    method = METHODS[name]
    # What is loaded and compiled at the first call is not of the method.
    few = {"input": records["input"][:200], "outputs": records["outputs"][:1, :200]}
    fit_all(method, records | few, 0.1)
    fits = fit_all(method, records, float(records["time_limit_s"]))
    content = {"version": version(PACKAGES[name.split()[0]]), "fits": fits}
    Path(result).write_text(json.dumps(content), encoding="utf-8")


if __name__ == "__main__":
    main()
