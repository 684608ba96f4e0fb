# SPDX-License-Identifier: BSD-3-Clause
"""From recordings to a model: the whole sequence of estimators."""

from piezo_identification import refinement
from piezo_identification.creep import estimate_creep
from piezo_identification.dynamics import estimate_dynamics
from piezo_identification.hysteresis import estimate_density
from piezo_identification.prediction import unseen_errors
from piezo_identification.sensor_sign import displacement_falls, reversed_displacement
from piezo_models.cascade import StageModel
from piezo_models.linear import CreepDynamics, ElectricVibrationDynamics
from piezo_models.model_file import IdentifiedModel
from piezo_recorder.reader import sha256_of


class IdentificationCancelled(Exception):
    """The identification was cancelled from outside."""


def identify(
    creep=None, dynamics=None, hysteresis=None, validation=None, progress=None, cancelled=None,
    refine=False, creep_pairs=None, modes=None, note=None,
):
    """Identify a stage model step by step (thesis 4.5).

    Creep first, then the fast dynamics with the creep taken off; both once more, as each was a
    small error to the other; then the hysteresis with all of them taken off. What no recording
    shows is left out of the model: no creep, or dynamics that pass the voltage on at once.

    Where the displacement falls as the voltage rises, the sensor counts the other way: the signs
    of all displacements are changed, and the model's displacement rises with the voltage.

    Parameters
    ----------
    creep, dynamics : Recording, optional
        Of the experiments of these names.
    hysteresis : Recording
        Of the hysteresis experiment.
    validation : Recording, optional
        Any other recording: the errors are measured on it.
    progress : callable, optional
        Called with (stage, fraction) when a stage begins, and with ("done", 1.0) at the end.
    cancelled : callable, optional
        Asked between stages; true ends the work.
    refine : bool
        True: fit all components together on all recordings but the validation, and keep the result
        if it is better on what was held out and on the validation. The errors then hold those of
        before too.
    creep_pairs, modes : int, optional
        Orders of creep and vibration; by default chosen from the data.
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
    given = {name: recording for name, recording in given.items() if recording is not None}
    signed = given
    if displacement_falls(hysteresis):
        signed = {name: reversed_displacement(recording) for name, recording in given.items()}

    def begin(stage, fraction):
        if cancelled is not None and cancelled():
            raise IdentificationCancelled(f"identification cancelled before: {stage}")
        if progress is not None:
            progress(stage, fraction)

    estimates = _linear_dynamics(
        signed.get("creep"), signed.get("dynamics"), creep_pairs, modes, begin
    )
    uncertainties = {name: each.standard_deviations for name, each in estimates.items()}
    creep_model = estimates["creep"].model if "creep" in estimates else CreepDynamics()
    dynamics_model = (estimates["dynamics"].model if "dynamics" in estimates
                      else ElectricVibrationDynamics())
    begin("hysteresis", 0.6)
    density = estimate_density(signed["hysteresis"], creep_model, dynamics_model)
    hysteresis_model = density.model()
    if note is not None:
        for name, estimate in estimates.items():
            note(f"order of the {name}:\n{estimate.order_table()}")
        note(f"hysteresis: {density.report()}")
    model = StageModel(hysteresis_model, creep_model, dynamics_model)
    errors = {}
    if refine:
        model, uncertainties, errors = _refined(model, uncertainties, signed, begin)
    begin("validation", 0.95)
    if "validation" in signed:
        errors = unseen_errors(model, signed["validation"]) | errors
    identified = IdentifiedModel(
        model=model,
        voltage_range_v=(hysteresis_model.voltage_min_v, hysteresis_model.voltage_max_v),
        sample_periods_s={
            name: recording.select(recording.playing).sample_period_s
            for name, recording in given.items() if name != "validation"
        },
        errors=errors,
        recordings=[
            {"path": str(recording.path), "sha256": sha256_of(recording.path)}
            for recording in given.values()
        ],
        uncertainties=uncertainties,
    )
    begin("done", 1.0)
    return identified


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


def _linear_dynamics(creep, dynamics, creep_pairs, modes, begin):
    """Estimates of creep and dynamics by these names, as far as there are recordings."""
    estimates = {}
    # Where only one is recorded, there is nothing to go through twice.
    passes = 2 if creep is not None and dynamics is not None else 1
    for turn in range(passes):
        if creep is not None:
            begin("creep beside the dynamics" if turn else "creep", 0.3 * turn)
            beside = estimates["dynamics"].model if turn else None
            estimates["creep"] = estimate_creep(creep, beside, creep_pairs)
        if dynamics is not None:
            begin("dynamics beside the creep" if turn else "dynamics", 0.2 + 0.3 * turn)
            beside = estimates["creep"].model if creep is not None else CreepDynamics()
            estimates["dynamics"] = estimate_dynamics(dynamics, beside, modes)
    return estimates
