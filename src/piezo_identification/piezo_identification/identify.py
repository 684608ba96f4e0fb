# SPDX-License-Identifier: BSD-3-Clause
"""From recordings to a model: the whole sequence of estimators."""

from dataclasses import replace

from piezo_common.cancellation import checking
from piezo_identification.conditioning.outlier_samples import (
    good_samples,
    outlier_text,
    with_outliers_marked,
)
from piezo_identification.conditioning.sensor_sign import displacement_falls, reversed_displacement
from piezo_identification.estimators.estimate import untold_parameters
from piezo_identification.estimators.frequency_response.response_file import FrequencyResponse
from piezo_identification.estimators.frequency_response.response_fit import ANY_ORDER
from piezo_identification.estimators.hysteresis.density_fit import estimate_density
from piezo_identification.estimators.linear_dynamics import METHODS, estimate_linear_dynamics
from piezo_identification.estimators.refinement import joint_fit as refinement
from piezo_identification.prediction import unseen_errors
from piezo_models.cascade import StageModel
from piezo_models.effects.delay import Delay
from piezo_models.identified_model import IdentifiedModel
from piezo_recorder.reading.reader import sha256_of


class IdentificationCancelled(Exception):
    """The identification was cancelled from outside."""


def identify(
    creep=None, dynamics=None, hysteresis=None, validation=None, progress=None, cancelled=None,
    refine=False, method=METHODS[0], order=ANY_ORDER, note=None,
):
    """Identify a stage model step by step (thesis 4.5).

    Creep first, then the fast dynamics with the creep taken off; both once more, as each was a
    small error to the other; then the hysteresis with all of them taken off. What no recording
    shows is left out of the model: no creep, or dynamics that pass the voltage on at once.

    Where the displacement falls as the voltage rises, the sensor counts the other way: the signs
    of all displacements are changed, and the model's displacement rises with the voltage.

    Parameters
    ----------
    creep : Recording, optional
        Of the experiment of this name.
    dynamics : Recording or FrequencyResponse, optional
        Of the experiment of this name or of `multisine`, or a measured frequency response. Of a
        response, the creep is taken where `creep` is not given, and the delay as an effect.
    hysteresis : Recording
        Of the hysteresis experiment.
    validation : Recording, optional
        Any other recording: the errors are measured on it.
    progress : callable, optional
        Called with (stage, fraction) when a stage begins, and with ("done", 1.0) at the end.
    cancelled : callable, optional
        Asked all the time; true ends the work.
    refine : bool
        True: fit all components together on all recordings but the validation, and keep the result
        if it is better on what was held out and on the validation. The errors then hold those of
        before too.
    method : str
        One of `linear_dynamics.METHODS`, for the fast dynamics.
    order : ResponseOrder
        Orders of creep and vibration; what it leaves open is chosen from the data.
    note : callable, optional
        Called with text for people: why the orders, and which part of the Preisach plane the data
        determine.

    Returns
    -------
    IdentifiedModel

    Raises
    ------
    ValueError
        If a recording does not fit its purpose, or that of the hysteresis is not given.
    IdentificationCancelled
        If `cancelled` said so.
    """
    if hysteresis is None:
        raise ValueError("there is no recording of the hysteresis: give one")
    given = {"creep": creep, "dynamics": dynamics, "hysteresis": hysteresis,
             "validation": validation}
    given = {name: data for name, data in given.items() if data is not None}
    if refine and isinstance(dynamics, FrequencyResponse):
        raise ValueError(
            f"{dynamics.path} is a frequency response, which refining cannot simulate: refine "
            "with recordings of samples only"
        )
    stage = "reading"

    def check():
        if cancelled is not None and cancelled():
            raise IdentificationCancelled(f"identification cancelled: {stage}")

    def begin(name, fraction):
        nonlocal stage
        stage = name
        check()
        if progress is not None:
            progress(stage, fraction)

    with checking(check):
        return _identify(given, begin, refine, method, order, note or (lambda text: None))


def _identify(given, begin, refine, method, order, note):
    signed = {name: _marked(name, data, note) for name, data in given.items()}
    if displacement_falls(signed["hysteresis"]):
        signed = {name: _reversed(data) for name, data in signed.items()}
    linear = estimate_linear_dynamics(
        signed.get("creep"), signed.get("dynamics"), signed["hysteresis"], method, order,
        lambda stage, fraction: begin(stage, 0.6 * fraction),
    )
    begin("hysteresis", 0.6)
    density = estimate_density(
        signed["hysteresis"], linear.creep, linear.dynamics, delay_s=linear.delay_s)
    for name, estimate in linear.estimates.items():
        note(f"order of the {name}:\n{estimate.order_table()}")
    note(f"hysteresis: {density.report()}")
    model = StageModel(
        density.model(), linear.creep, linear.dynamics,
        effects=(Delay(linear.delay_s),) if linear.delay_s else (),
    )
    uncertainties, errors = linear.uncertainties, {}
    if refine:
        model, uncertainties, errors = _refined(model, uncertainties, signed, begin)
    untold = untold_parameters(model, uncertainties)
    if untold:
        note(f"the recordings do not tell {', '.join(untold)}: the standard deviation is larger "
             "than the value; ask for a lower order, or record more")
    begin("validation", 0.95)
    if "validation" in signed:
        errors = unseen_errors(model, signed["validation"]) | errors
    identified = IdentifiedModel(
        model=model,
        voltage_range_v=(model.hysteresis.voltage_min_v, model.hysteresis.voltage_max_v),
        sample_periods_s={
            name: data.select(data.playing).sample_period_s for name, data in given.items()
            if name != "validation" and not isinstance(data, FrequencyResponse)
        },
        errors=errors,
        recordings=[
            {"path": str(data.path), "sha256": sha256_of(data.path)} for data in given.values()
        ],
        uncertainties=uncertainties, visited=density.visited,
    )
    begin("done", 1.0)
    return identified


def _marked(name, data, note):
    """Data whose outliers are marked: least squares cannot bear them."""
    if isinstance(data, FrequencyResponse):
        return data
    data = with_outliers_marked(data)
    text = outlier_text(name, ~good_samples(data), data.time_s)
    if text:
        note(text)
    return data


def _reversed(data):
    """Data of a sensor that counts the other way."""
    if isinstance(data, FrequencyResponse):
        return replace(data, gain=-data.gain)
    return reversed_displacement(data)


def _refined(model, uncertainties, recordings, begin):
    """Refined model and its standard deviations, or the given ones; and errors before and after."""
    fitted = {name: part for name, part in recordings.items() if name != "validation"}
    result = refinement.refine(
        model, fitted, lambda fraction: begin("refinement", 0.7 + 0.25 * fraction)
    )
    errors = {"held_out_e_y_percent": {
        "before_refinement": result.before_percent, "after_refinement": result.after_percent
    }}
    improved = result.improved
    if "validation" in recordings:
        before, after = (
            unseen_errors(each, recordings["validation"]) for each in (model, result.model)
        )
        errors |= {"before_refinement": before, "after_refinement": after}
        improved = improved and after["e_y_percent"] <= before["e_y_percent"]
    errors["refinement_kept"] = float(improved)
    if not improved:
        return model, uncertainties, errors
    return result.model, result.standard_deviations, errors
