# SPDX-License-Identifier: BSD-3-Clause
"""From recordings to a model: the whole sequence of estimators."""

from piezo_identification.creep import estimate_creep
from piezo_identification.dynamics import estimate_dynamics
from piezo_identification.hysteresis import estimate_hysteresis
from piezo_identification.prediction import unseen_errors
from piezo_models.cascade import StageModel
from piezo_models.model_file import IdentifiedModel
from piezo_recorder.reader import sha256_of


class IdentificationCancelled(Exception):
    """The identification was cancelled from outside."""


def identify(creep, dynamics, hysteresis, validation=None, progress=None, cancelled=None):
    """Identify a stage model step by step (thesis 4.5).

    Creep first, then the fast dynamics with the creep taken off; both once more, as each was a
    small error to the other; then the hysteresis with all of them taken off.

    Parameters
    ----------
    creep, dynamics, hysteresis : Recording
        Of the experiments of these names.
    validation : Recording, optional
        Any other recording: the errors are measured on it.
    progress : callable, optional
        Called with (stage, fraction) when a stage begins, and with ("done", 1.0) at the end.
    cancelled : callable, optional
        Asked between stages; true ends the work.

    Returns
    -------
    IdentifiedModel

    Raises
    ------
    ValueError
        If a recording does not fit its purpose.
    IdentificationCancelled
        If `cancelled` said so.
    """
    def begin(stage, fraction):
        if cancelled is not None and cancelled():
            raise IdentificationCancelled(f"identification cancelled before: {stage}")
        if progress is not None:
            progress(stage, fraction)

    begin("creep", 0.0)
    creep_model = estimate_creep(creep).model
    begin("dynamics", 0.2)
    dynamics_model = estimate_dynamics(dynamics, creep_model).model
    begin("creep beside the dynamics", 0.3)
    creep_estimate = estimate_creep(creep, dynamics_model)
    begin("dynamics beside the creep", 0.5)
    dynamics_estimate = estimate_dynamics(dynamics, creep_estimate.model)
    creep_model, dynamics_model = creep_estimate.model, dynamics_estimate.model
    begin("hysteresis", 0.6)
    hysteresis_model = estimate_hysteresis(hysteresis, creep_model, dynamics_model)
    model = StageModel(hysteresis_model, creep_model, dynamics_model)
    begin("validation", 0.95)
    errors = unseen_errors(model, validation) if validation is not None else {}
    recordings = {"creep": creep, "dynamics": dynamics, "hysteresis": hysteresis}
    used = [*recordings.values(), *([validation] if validation is not None else [])]
    identified = IdentifiedModel(
        model=model,
        voltage_range_v=(hysteresis_model.voltage_min_v, hysteresis_model.voltage_max_v),
        sample_periods_s={
            name: recording.select(recording.playing).sample_period_s
            for name, recording in recordings.items()
        },
        errors=errors,
        recordings=[
            {"path": str(recording.path), "sha256": sha256_of(recording.path)}
            for recording in used
        ],
        uncertainties={
            "creep": creep_estimate.standard_deviations,
            "dynamics": dynamics_estimate.standard_deviations,
        },
    )
    begin("done", 1.0)
    return identified
