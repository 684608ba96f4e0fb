# SPDX-License-Identifier: BSD-3-Clause
"""Creep, electric and vibration dynamics and a delay from a measured frequency response."""

from collections.abc import Iterator
from dataclasses import asdict, astuple, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piezo_common.arrays import FloatArray
from piezo_common.budget import while_time_lasts
from piezo_identification.estimators.estimate import (
    Estimate,
    OrderTrial,
    independent_rows,
    parameter_covariance,
    propagated,
)
from piezo_identification.estimators.frequency_response.rational_form import DELAY, LAG
from piezo_identification.estimators.frequency_response.response_file import FrequencyResponse
from piezo_identification.estimators.frequency_response.response_hold import without_hold
from piezo_identification.estimators.frequency_response.response_model import (
    ANY_ORDER,
    ResponseModel,
    ResponseOrder,
)
from piezo_identification.estimators.frequency_response.response_search import (
    LAST_ROUNDING,
    LAST_STEPS,
    ResponseFit,
    ResponseSearch,
)
from piezo_models.effects.coupled_mode import CoupledMode
from piezo_models.effects.vibration_mode import VibrationMode
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics

MOST_STATES = 60
"""Number of states at which the search for the order ends."""

LEAST_FREQUENCIES = 24
"""Fewest frequencies with which orders can be compared."""

FREQUENCIES_A_MODE = 8
"""Fewest frequencies per mode: a mode has four parameters, each frequency two values."""

BEST_IN_SERIES = 3
"""Number of fits of modes in series from which smaller models are sought."""

STRONG_EVIDENCE = 6.0
"""Gain in information required for coupled modes over those of a structure, because they can
imitate these in many ways (Kass and Raftery, "Bayes factors", 1995)."""

BARE_MENTION = 2.0
"""Gain in information that is not worth more than a bare mention (Kass and Raftery): of models
within it, that with the fewest parameters is chosen."""

STEP = 1e-6
"""Step in the parameters of a fit for numerical derivatives of those of the model."""


def estimate_from_response(
    measured: FrequencyResponse, order: ResponseOrder = ANY_ORDER, most_states: int = MOST_STATES,
    has_loss: bool = False,
) -> Estimate:
    """Fit a measured frequency response with creep, a lag, modes, antiresonances and a delay.

    Poles with free residues are fitted first, one more pair each time, starting from vector fits
    and from the residual. The best of these fits, and the same modes in series with the zeros
    between them (4.3), are then reduced: a lag, a delay, an instantaneous part, a part proportional
    to the velocity of a mode, a mode, an antiresonance, or a creep pair is removed, and the rest
    refitted. The Bayesian information criterion decides. Frequencies are weighted by their noise.

    Parameters
    ----------
    measured : FrequencyResponse
        Part of the response in which the signal exceeds the noise (`between`). The model is that of
        the stage alone: a hold in the response is removed.
    order : ResponseOrder
        Requested orders; open ones are chosen by the criterion.
    most_states : int
        Largest order that is tried.
    has_loss : bool
        Whether the stage has hysteresis, by which sines of any frequency may lag by the same angle.
        The model does not contain this lag.

    Returns
    -------
    Estimate
        Its model is a `ResponseModel`, its order a `ResponseOrder`. The standard deviations have
        the fields `gain`, `delay_s`, `creep` and `dynamics`. They account for the correlation of
        errors at neighbouring frequencies.

    Raises
    ------
    ValueError
        If there are too few frequencies for the order.

    Examples
    --------
    >>> import numpy as np
    >>> from piezo_identification import read_frequency_response
    >>> frequency_hz = np.geomspace(10.0, 1000.0, 60)
    >>> s = 2j * np.pi * frequency_hz
    >>> gain = 2.0 / (1.0 + 0.04 * s / 1257.0 + (s / 1257.0) ** 2)
    >>> np.savetxt("response.csv", np.column_stack([frequency_hz, gain.real, gain.imag]),
    ...            delimiter=",", comments="", header="frequency_hz,gain_re,gain_im")
    >>> estimate = estimate_from_response(read_frequency_response("response.csv"))
    >>> print(np.round(estimate.model.dynamics.mode_frequencies_rad_per_s))
    [1257.]
    """
    frequencies = measured.frequency_hz.size
    if frequencies < LEAST_FREQUENCIES:
        raise ValueError(
            f"{measured.path} has {frequencies} frequencies, too few: measure at least "
            f"{LEAST_FREQUENCIES}"
        )
    if max(order.modes or 0, order.antiresonances or 0) > frequencies // FREQUENCIES_A_MODE:
        raise ValueError(
            f"{measured.path} has {frequencies} frequencies, which does not allow order {order}: "
            "ask for fewer modes or antiresonances"
        )
    search = ResponseSearch(without_hold(measured), has_loss)
    granted: dict[ResponseOrder, ResponseFit] = {}
    fits = _fits(search, order, min(most_states, frequencies // 4))

    def take(fit: ResponseFit) -> None:
        found = _order(fit)
        if not order.grants(found) or not _is_model(search, fit):
            return
        if found not in granted or search.information(fit) < search.information(granted[found]):
            granted[found] = fit

    while not granted and (first := next(fits, None)) is not None:
        take(first)
    with while_time_lasts("further orders of the response"):
        for fit in fits:
            take(fit)
    if not granted:
        raise ValueError(f"{measured.path} cannot be described by order {order}: ask for another")
    information = {found: search.information(fit) + STRONG_EVIDENCE * found.is_coupled
                   for found, fit in granted.items()}
    nearly = min(information.values()) + BARE_MENTION
    chosen = min((found for found in granted if information[found] <= nearly),
                 key=lambda found: (granted[found].parameters, information[found]))
    best = granted[chosen]
    trials = tuple(_trial(search, found, fit) for found, fit in granted.items())
    if measured.hold_s:
        # The model determines the aliases.
        model = _model(search, best)
        search = ResponseSearch(
            without_hold(measured, model.linear(), model.delay_s), has_loss)
    best = search.fit((best.form, best.vector, best.free), LAST_STEPS, LAST_ROUNDING)
    model = _model(search, best)
    deviations, of_effects = _deviations(search, best, model)
    is_given = None not in (order.creep_pairs, order.modes, order.antiresonances)
    return Estimate(model, deviations, chosen, trials, is_given, effects=model.parallel,
                    effect_deviations=of_effects)


def _fits(
    search: ResponseSearch, order: ResponseOrder, most_states: int,
) -> Iterator[ResponseFit]:
    """Yield fits of modes in parallel and in series, and the reduced forms of the best of them."""
    grown = list[ResponseFit]()
    for fit in search.grown(order, most_states):
        grown.append(fit)
        yield fit
    enough = [fit for fit in grown if fit.form.modes >= (order.modes or 0)]
    best = search.with_another_lag(min(enough, key=search.information))
    grown = [best if fit.form == best.form else fit for fit in grown]
    yield best
    least = np.inf
    if order.antiresonances is None:
        parallel = [best, *search.reduced(best, order)]
        if best.form.modes:
            real = search.with_real_parts(best)
            parallel += [real, *search.reduced(real, order, min(map(search.information, parallel)))]
        yield from parallel
        least = min(map(search.information, parallel))
    series = [search.in_series(fit, order.antiresonances) for fit in grown
              if (order.modes or 0) <= fit.form.modes <= best.form.modes + 1 and fit.form.modes]
    yield from series
    for fit in sorted(series, key=search.information)[:BEST_IN_SERIES]:
        yield from search.reduced(fit, order, least)


def _trial(search: ResponseSearch, order: ResponseOrder, fit: ResponseFit) -> OrderTrial:
    residual = np.sqrt(fit.cost / (2.0 * search.rate.size))
    return OrderTrial(order, fit.parameters, float(residual), search.information(fit))


def _in_dynamics(fit: ResponseFit) -> NDArray[np.intp]:
    """Return the modes of `ElectricVibrationDynamics`: those in series, or one parallel mode.

    Of parallel modes, it is the largest one without a velocity part, if there is no instantaneous
    part.
    """
    form = fit.form
    if not form.is_parallel:
        return np.argsort(fit.vector[form.mode_places[0]])
    plain = np.flatnonzero(~fit.free[form.mode_places[3]])
    if fit.free[form.gain_place] or not plain.size:
        return np.empty(0, dtype=np.intp)
    parts = np.abs(fit.vector[form.mode_places[2]])
    return plain[[np.argmax(parts[plain])]]


def _order(fit: ResponseFit) -> ResponseOrder:
    form, free = fit.form, fit.free
    modes = _in_dynamics(fit).size
    is_coupled = form.is_parallel and bool(np.any(free[form.mode_places[3]]))
    return ResponseOrder(form.creep_pairs, modes, form.antiresonances, form.modes - modes,
                         is_coupled, bool(free[LAG]), bool(free[DELAY]))


def _model(search: ResponseSearch, fit: ResponseFit) -> ResponseModel:
    """Model with the parameters of a fit, its components in order of frequency."""
    form, vector, top = fit.form, fit.vector, search.rate[-1]
    poles, zeros = np.sort(np.exp(vector[form.creep_places]))
    modes = _in_dynamics(fit)
    series = np.exp(vector[form.mode_places[:2, modes]])
    antiresonances = np.exp(vector[form.zero_places])
    antiresonances = antiresonances[:, np.argsort(antiresonances[0])]
    gain, parallel = vector[form.gain_place], tuple[VibrationMode, ...]()
    if form.is_parallel:
        parts = vector[form.mode_places[2:]]
        gain += np.sum(parts[0])
        others = np.setdiff1d(np.argsort(vector[form.mode_places[0]]), modes)
        others = others[np.argsort(vector[form.mode_places[0, others]])]
        parallel = tuple(_mode(*np.exp(vector[form.mode_places[:2, mode]]), *parts[:, mode] / gain)
                         for mode in others)
    dynamics = ElectricVibrationDynamics(vector[LAG] / top, *map(tuple, (*series, *antiresonances)))
    return ResponseModel(
        float(gain), float(vector[DELAY] / top), CreepDynamics(tuple(poles), tuple(zeros)),
        dynamics, parallel)


def _is_model(search: ResponseSearch, fit: ResponseFit) -> bool:
    """Return whether the parameters are within the bounds of the effects."""
    try:
        _model(search, fit)
    except ValueError:
        return False
    return True


def _mode(frequency: float, damping: float, position: float, velocity: float) -> VibrationMode:
    """Return a parallel mode: a `VibrationMode` if its numbers allow it, else a `CoupledMode`."""
    numbers = float(frequency), float(damping), float(position)
    is_plain = velocity == 0.0 and all(
        field.metadata["low"] <= number <= field.metadata["high"]
        for field, number in zip(fields(VibrationMode), numbers, strict=True))
    return VibrationMode(*numbers) if is_plain else CoupledMode(*numbers, float(velocity))


def _numbers(model: ResponseModel) -> FloatArray:
    """All parameters of a model; four for each parallel mode."""
    parallel = [(*astuple(mode), 0.0)[:4] for mode in model.parallel]
    return np.concatenate([np.ravel(part) for part in (
        model.gain, model.delay_s, *astuple(model.creep), *astuple(model.dynamics), *parallel)])


def _deviations(
    search: ResponseSearch, fit: ResponseFit, model: ResponseModel,
) -> tuple[dict[str, Any], tuple[dict[str, float], ...]]:
    """Standard deviations of the parameters of a model, and of those of its effects."""
    residual, slopes = search.residual(fit.form, fit.vector)
    covariance = parameter_covariance(slopes[:, fit.free], residual)
    covariance *= residual.size / independent_rows(residual)
    steps = STEP * np.eye(fit.vector.size)[fit.free]
    # No model has a negative lag or delay.
    behind = np.maximum(fit.vector - steps, fit.form.bounds(search.rate)[0])
    sensitivity = np.column_stack([
        (_numbers(_model(search, replace(fit, vector=after)))
         - _numbers(_model(search, replace(fit, vector=before)))) / np.sum(after - before)
        for after, before in zip(fit.vector + steps, behind, strict=True)])
    spread = iter(np.sqrt(np.diag(propagated(sensitivity, covariance))).tolist())
    deviations: dict[str, Any] = {"gain": next(spread), "delay_s": next(spread)}
    for name, part in (("creep", model.creep), ("dynamics", model.dynamics)):
        deviations[name] = {
            key: tuple(next(spread) for _ in value) if isinstance(value, tuple) else next(spread)
            for key, value in asdict(part).items()}
    of_effects = []
    for mode in model.parallel:
        four = [next(spread) for _ in range(4)]
        of_effects.append({field.name: each for field, each in zip(
            fields(mode), four, strict=False)})
    return deviations, tuple(of_effects)
