# SPDX-License-Identifier: BSD-3-Clause
"""The steps from recordings to a controller, for files, arrays and pandas frames."""

import warnings
from collections.abc import Callable, Sequence
from hashlib import sha256
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from piezo_common.budget import Budget
from piezo_controller.feedback.feedback_design import FeedbackController
from piezo_controller.feedback.sample_rate.named_feedbacks import feedback_at_margin
from piezo_controller.feedback.stage_design import design_for_stage
from piezo_controller.feedback.synthesis.design_choices import (
    DEFAULT_WEIGHTS,
    DISTURBANCE_HZ,
    METHODS,
    PEAK_SENSITIVITY,
    SAMPLE_RATE_HZ,
)
from piezo_identification.axes.diagnose_axes import AxesDiagnosis, diagnose_axes
from piezo_identification.axes.identify_axes import identify_several_axes
from piezo_identification.axes.predict_axes import AxesPrediction, predict_several_axes
from piezo_identification.commands.response_options import READINGS
from piezo_identification.diagnosis.diagnose import Diagnosis
from piezo_identification.diagnosis.diagnose import diagnose as diagnose_recordings
from piezo_identification.diagnosis.evidence.known_noise import noise_of_model
from piezo_identification.diagnosis.joint.identification_recordings import (
    find_identification_recordings,
)
from piezo_identification.diagnosis.report.diagnosis_results import stated_error_um
from piezo_identification.diagnosis.response.response_diagnosis import diagnose_response
from piezo_identification.diagnosis.verdict import Verdict, extended_model
from piezo_identification.estimators.frequency_response.response_fit import ResponseOrder
from piezo_identification.identification.estimated_loops import DensityOptions
from piezo_identification.identification.identify import identify as identify_recordings
from piezo_identification.identification.notes import Implausible
from piezo_identification.prediction.prediction import Prediction
from piezo_identification.prediction.row_reading import all_as_identified, predict_as_identified
from piezo_identification.recording_check.suitability import misfits
from piezo_models.axes.identified_axes import IdentifiedAxes
from piezo_models.cascade import StageModel
from piezo_models.identified_model import IdentifiedModel
from piezo_models.model_file import load_model
from piezo_offline.files import load_model as load_any_model
from piezo_offline.python_data import (
    DataWarning,
    axes_data_of,
    axes_recordings_of,
    axes_response_in,
    in_list,
    read,
    recordings_of,
    response_in,
)
from piezo_recorder.reading.axes import AxesRecording

if TYPE_CHECKING:
    from matplotlib.figure import Figure

AnyModel = IdentifiedModel | StageModel | str | PathLike[str]


def identify(
    creep: Any = None, dynamics: Any = None, hysteresis: Any = None, validation: Any = None, *,
    columns: Sequence[str] = (), method: str = "output-error", creep_pairs: int | None = None,
    modes: int | None = None, grid: int | None = None, refine: bool = False,
    rows_read: str = "start",
    progress: Callable[[str, float], object] | None = None,
    note: Callable[[str], object] | None = None, budget_s: float | None = None,
) -> IdentifiedModel | IdentifiedAxes:
    """Identify a model of the stage from recordings; at least one of the first three.

    Recordings of several axes (`piezo_recorder.AxesRecording`, or tables and arrays with columns
    such as ``x_voltage_v``) give one model of all axes. So does their frequency response as
    `dynamics`: `piezo_identification.AxesResponse`, ``control.FrequencyResponseData`` in um/V, or a
    table. The only options are then `modes`, `progress`, `note` and `budget_s`.

    Parameters
    ----------
    creep, dynamics, hysteresis : path, arrays by name, pandas.DataFrame or Recording, optional
        As for `piezo_offline.read`, or a list of several. The dynamics may be a frequency response.
    validation : the same, one, optional
        Recording that is not fitted, on which the errors of the model are measured.
    columns : sequence of str
        As for `piezo_offline.read`; applies to all recordings.
    method : str
        No effect, like ``piezo identify --method``.
    creep_pairs, modes : int, optional
        Orders of creep and dynamics; chosen from the data by default.
    grid : int, optional
        Cells of the hysteresis along each threshold; chosen from the data by default.
    refine : bool
        No effect: all components are always fitted together at the end.
    rows_read : str
        "start" or "end" of a row: when the logger reads the displacement, see ``--rows-read``.
    progress : callable, optional
        Called with the present step and the fraction done (0 to 1).
    note : callable, optional
        Called with sentences on orders, coverage and initial values; for example ``print``.
        Implausible data are also reported as `DataWarning`.
    budget_s : float, optional
        Time in s after which the searches end with the best result so far; `unfinished` of the
        model then lists what they did not try. Ctrl-C does the same, once there is a model.

    Raises
    ------
    ValueError
        If a recording cannot be read or is unsuitable for its purpose, or none is given.

    Examples
    --------
    >>> import numpy as np
    >>> frequency_hz = np.geomspace(10.0, 1000.0, 60)
    >>> s = 2j * np.pi * frequency_hz
    >>> gain = 2.0 / (1.0 + 0.04 * s / 1257.0 + (s / 1257.0) ** 2)
    >>> np.savetxt("response.csv", np.column_stack([frequency_hz, gain.real, gain.imag]),
    ...            delimiter=",", comments="", header="frequency_hz,gain_re,gain_im")
    >>> model = identify(dynamics="response.csv")
    >>> print(np.round(model.model.dynamics.mode_frequencies_rad_per_s, 3))
    [1257.]
    """
    all_data = {"creep": creep, "dynamics": dynamics, "hysteresis": hysteresis,
                "validation": validation}
    of_axes = axes_data_of(all_data)
    if of_axes:
        return identify_several_axes(
            **of_axes, pairs=modes, note=note or (lambda text: None),
            progress=progress or (lambda what, part: None), budget=Budget(budget_s))
    given: dict[str, Any] = {}
    for name, data in all_data.items():
        response = response_in(data) if name == "dynamics" else None
        if data is None:
            continue
        if response is not None:
            given[name] = response
            continue
        listed = recordings_of(data, columns, name)
        for misfit in misfits(listed, name):
            warnings.warn(misfit.sentence, DataWarning, stacklevel=2)
        given[name] = listed[0] if len(listed) == 1 else listed

    def collect(text: str) -> None:
        if isinstance(text, Implausible):
            warnings.warn(text, DataWarning, stacklevel=3)
        if note is not None:
            note(text)

    return identify_recordings(
        **given, progress=progress, refine=refine, method=method, note=collect,
        order=ResponseOrder(creep_pairs, modes, None), density=DensityOptions(grid),
        read_at_samples=_read_at(rows_read), budget=Budget(budget_s))


def simulate(model: AnyModel | IdentifiedAxes, data: Any, *, columns: Sequence[str] = (),
             rows_read: str = "start") -> Prediction | AxesPrediction:
    """Run a model on the voltage of a recording, and compare it with the measured displacement.

    Parameters
    ----------
    model : IdentifiedModel, StageModel, IdentifiedAxes or path-like
    data : path, arrays by name, pandas.DataFrame, Recording or AxesRecording
    columns, rows_read
        As for `identify`. Without `rows_read`, rows are read as in the identification if the model
        then fits better.

    Returns
    -------
    piezo_identification.Prediction or AxesPrediction
        Measured and simulated displacement, with `e_y_percent` and `plot`.

    Raises
    ------
    ValueError
        If the recording cannot be read or is too short.

    Examples
    --------
    >>> time_s = 1e-3 * np.arange(500)
    >>> voltage_v = 5.0 - 5.0 * np.cos(20.0 * time_s)
    >>> recording = {"time_s": time_s, "voltage_v": voltage_v, "displacement_um": 2.0 * voltage_v}
    >>> prediction = simulate(model, recording)     # the model of `identify`
    >>> print(f"{prediction.e_y_percent():.2f} %")
    0.96 %
    """
    opened = _opened(model)
    if isinstance(opened, IdentifiedAxes):
        return predict_several_axes(opened.model, _one_of_axes(data))
    recording = read(data, columns)
    prediction, sentences = predict_as_identified(opened, recording, _read_at(rows_read))
    for sentence in sentences:
        warnings.warn(sentence, DataWarning, stacklevel=2)
    return prediction


def diagnose(model: AnyModel | IdentifiedAxes, data: Any, holdout: Any = None, *,
             identified_from: Any = None, columns: Sequence[str] = (),
             progress: Callable[[str, float], None] | None = None,
             budget_s: float | None = None) -> Verdict | AxesDiagnosis:
    """Find what a model lacks to explain recordings.

    A model of several axes takes one recording or frequency response, and no other option.

    Parameters
    ----------
    model : IdentifiedModel, StageModel, IdentifiedAxes or path-like
    data : path, arrays by name, pandas.DataFrame or Recording, or a list of several
        Recordings, or one frequency response.
    holdout : the same, one, optional
        Recording on which the errors before and after are measured; a part of `data` by default.
    identified_from : the same, one or a list of several, optional
        Recordings that the model was identified from, which show effects that were already in the
        stage then. By default the files that the model names, if they still exist.
    columns : sequence of str
        As for `piezo_offline.read`; applies to all recordings.
    progress : callable, optional
        Called with the present step and the fraction done (0 to 1).
    budget_s : float, optional
        Time in s after which the comparison ends with the best result so far; `not_tried` of the
        verdict then lists what is missing. Ctrl-C does the same.

    Returns
    -------
    Verdict or AxesDiagnosis
        Has `summary`, `plot` and the extended model; `extend` prepares it for saving. That of
        several axes has `summary` and `extended`, which `save_model` takes.

    Raises
    ------
    ValueError
        If a recording cannot be read or used.

    Examples
    --------
    >>> late = gain * np.exp(-1e-4 * s)             # of `identify`, behind a delay of 0.1 ms
    >>> np.savetxt("late.csv", np.column_stack([frequency_hz, late.real, late.imag]),
    ...            delimiter=",", comments="", header="frequency_hz,gain_re,gain_im")
    >>> verdict = diagnose(model, "late.csv")
    >>> verdict.verdict, [effect["name"] for effect in verdict.effects]
    ('explained', ['delay'])
    """
    opened = _opened(model)
    if isinstance(opened, IdentifiedAxes):
        if holdout is not None or identified_from is not None:
            raise ValueError("holdout and identified_from are for a model of one axis: leave them "
                             "out")
        return diagnose_axes(opened, axes_response_in(data) or _one_of_axes(data))
    stage_model = opened if isinstance(opened, StageModel) else opened.model
    response = response_in(data)
    if response is not None:
        return diagnose_response(
            stage_model, response, progress or (lambda what, fraction: None), Budget(budget_s))
    judged = recordings_of(data, columns, "data")
    held = [] if holdout is None else [read(holdout, columns, "held-out data")]
    given, sentences = all_as_identified(opened, judged)
    for sentence in sentences:
        warnings.warn(sentence, DataWarning, stacklevel=2)
    held_out = next(iter(all_as_identified(opened, held)[0]), None)
    identified = opened if isinstance(opened, IdentifiedModel) else IdentifiedModel(
        opened, (opened.hysteresis.voltage_min_v, opened.hysteresis.voltage_max_v))
    moved = [] if identified_from is None else [
        each if isinstance(each, str | PathLike) else read(each, columns, "identified_from")
        for each in in_list(identified_from)]
    known = find_identification_recordings(
        identified, model if isinstance(model, str | PathLike) else ".",
        lambda path: recordings_of(path, columns, str(path)), moved, [*judged, *held])
    return diagnose_recordings(
        stage_model, given, held_out, progress, known, stated_error_um(identified),
        noise_of_model(identified), Budget(budget_s))


def plot_residuals(verdict: Diagnosis, recording: int = 0) -> "Figure":
    """Draw the residual of a recording over time, before and after the model's extension.

    Parameters
    ----------
    verdict : Diagnosis
        Result of `diagnose` for recordings.
    recording : int
        Index of the diagnosed recording.
    """
    from piezo_identification.diagnosis.report.diagnosis_pictures import residuals_of

    return residuals_of(verdict, recording)


def extend(model: IdentifiedModel | str | PathLike[str], verdict: Verdict, data: Any, *,
           columns: Sequence[str] = ()) -> IdentifiedModel:
    """Return the identified model with the effects of a verdict, for saving and use.

    Parameters
    ----------
    model : IdentifiedModel or path-like
        Model that was diagnosed.
    data : as `diagnose` took
        Data that were diagnosed, for the origin in the model.

    Returns
    -------
    IdentifiedModel
        The given model if the verdict adds nothing.

    Examples
    --------
    >>> [late] = extend(model, verdict, "late.csv").model.effects     # that of `diagnose`
    >>> print(f"{late.name} of {late.delay_s:.4g} s")
    delay of 0.0001 s
    """
    identified = model if isinstance(model, IdentifiedModel) else load_model(model)
    response = response_in(data)
    origin = [response.path] if response else recordings_of(data, columns, "data")
    return extended_model(identified, verdict, origin)


def design(
    model: AnyModel, *, method: str = METHODS[0], weights: str | Path = DEFAULT_WEIGHTS,
    disturbance_hz: float = DISTURBANCE_HZ, samples_per_tick: int | None = None,
    delay_ticks: int = 1, sample_rate_hz: float = SAMPLE_RATE_HZ, feedback: str | None = None,
    peak_sensitivity: float = PEAK_SENSITIVITY,
) -> FeedbackController:
    """Design the feedback for a model.

    Parameters
    ----------
    model : IdentifiedModel, StageModel or path-like
    method : str
        "h_infinity", or "pid" or "pi" by Ziegler and Nichols.
    weights : str or Path
        "default", "thesis" or a YAML file.
    disturbance_hz : float
        Bandwidth of the disturbances in Hz.
    samples_per_tick : int, optional
        Feedback period in samples of the stage; by the rules (5.10) by default.
    delay_ticks : int
        1 if the controller responds to the stage, 0 if the stage evaluates the law itself.
    sample_rate_hz : float
        Sample rate of the stage in Hz.
    feedback : str, optional
        "h-infinity", "pi", "pid", "integral-resonant", "positive-position", "force-like" or
        "repetitive": a law at the sample rate instead, which uses only `disturbance_hz` and
        `sample_rate_hz` of the other arguments; see `feedback_at_margin`.
    peak_sensitivity : float
        Peak sensitivity of that law.

    Returns
    -------
    FeedbackController
        Has `summary`, and `plot`, which takes a model to draw the loop.

    Raises
    ------
    ValueError
        If there is no such feedback; the message gives the reason.

    Examples
    --------
    >>> from piezo_models import (
    ...     CreepDynamics, ElectricVibrationDynamics, PreisachModel, StageModel)
    >>> line = PreisachModel.line(0.0, 10.0, 2.0)
    >>> stage = StageModel(line, CreepDynamics(), ElectricVibrationDynamics(1e-3))
    >>> controller = design(stage, method="pi")
    >>> controller.report["method"], controller.report["order"]
    ('pi', 1)
    """
    if not 0.0 < sample_rate_hz < float("inf"):
        raise ValueError(f"sample_rate_hz is {sample_rate_hz:g}: give a positive number")
    stage_model, digest = _identified(model)
    if feedback is not None:
        return feedback_at_margin(feedback, stage_model, disturbance_hz, peak_sensitivity,
                                  1.0 / sample_rate_hz, digest)
    return design_for_stage(
        stage_model, weights, method, disturbance_hz=disturbance_hz,
        samples_per_tick=samples_per_tick, delay_ticks=delay_ticks,
        model_sha256=digest, sample_rate_hz=sample_rate_hz).controller


def _opened(model: AnyModel | IdentifiedAxes) -> IdentifiedModel | StageModel | IdentifiedAxes:
    """Return a model, read from its file if necessary."""
    if isinstance(model, IdentifiedModel | StageModel | IdentifiedAxes):
        return model
    if isinstance(model, str | PathLike):
        return load_any_model(model)
    raise TypeError(f"{type(model).__name__} is no model: give a model, or the path of its file")


def _one_of_axes(data: Any) -> AxesRecording:
    """Return the recording of several axes."""
    found = axes_recordings_of(data, "data")
    if len(found) != 1:
        raise ValueError(f"the data hold {len(found)} recordings of several axes: give one")
    return found[0]


def _identified(model: AnyModel) -> tuple[StageModel, str]:
    """Return the model without its identification, and the hash of its file, if any."""
    if isinstance(model, StageModel):
        return model, ""
    if isinstance(model, IdentifiedModel):
        return model.model, ""
    return load_model(model).model, sha256(Path(model).read_bytes()).hexdigest()


def _read_at(rows_read: str) -> float:
    if rows_read not in READINGS:
        raise ValueError(f'rows_read is {rows_read!r}: give "start" or "end"')
    return READINGS[rows_read]
