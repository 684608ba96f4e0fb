# SPDX-License-Identifier: BSD-3-Clause
"""The controller file: one versioned JSON document, written at once and read strictly."""

import json
import math
from pathlib import Path

import numpy as np

from piezo_common.text_file import (
    UnreadableFile,
    is_something_else,
    read_bounded_text,
    replace_text,
)
from piezo_controller.feedback.feedback_design import (
    FeedbackController,
    UnstableLoop,
    check_stabilises,
)

FORMAT = "piezo_stage_controller"
VERSION = 1
FIELDS = ("format", "version", "model_sha256", "sample_period_s", "report", "weights",
          "A", "B", "C", "D")


class ControllerFileError(ValueError):
    """A controller file that cannot be read or written: says path, field and cure."""


def save_controller(path, controller):
    """Write a controller file; the file at `path` is replaced at once or not at all.

    Parameters
    ----------
    path : path-like
    controller : FeedbackController

    Raises
    ------
    ControllerFileError
        The file cannot be written, is there already and no controller file, or the controller
        holds a value that is not finite.
    """
    path = Path(path)
    matrices = {name: np.asarray(getattr(controller, name)).tolist() for name in "ABCD"}
    document = {"format": FORMAT, "version": VERSION, "model_sha256": controller.model_sha256,
                "sample_period_s": controller.sample_period_s, "report": controller.report,
                "weights": controller.weights, **matrices}
    if is_something_else(path, FORMAT):
        raise ControllerFileError(f"{path}: is there already and is no controller file, so it is "
                                  "not overwritten; choose another name")
    try:
        replace_text(path, json.dumps(document, indent=1, allow_nan=False) + "\n")
    except ValueError:
        raise ControllerFileError(
            f"{path}: the controller holds a value that is not finite; design it again") from None
    except OSError as error:
        raise ControllerFileError(f"{path}: cannot be written ({error.strerror}); "
                                  "choose a directory that exists and is writable") from None


def load_controller(path):
    """Read a controller file.

    Parameters
    ----------
    path : path-like

    Returns
    -------
    FeedbackController

    Raises
    ------
    ControllerFileError
        The file is missing, is not a controller file of this version, or has a missing, unknown
        or invalid field.
    """
    try:
        document = json.loads(read_bounded_text(path))
    except UnreadableFile as error:
        raise ControllerFileError(f"{path}: {error}; give a controller file") from None
    except (ValueError, RecursionError):
        raise ControllerFileError(f"{path}: is not JSON; give a controller file") from None

    def refuse(name, problem):
        raise ControllerFileError(f"{path}: {name} {problem}; design the controller again")

    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise ControllerFileError(f'{path}: format is not "{FORMAT}"; give a controller file')
    if document.get("version") != VERSION:
        refuse("version", f"is {document.get('version')!r}, not {VERSION}")
    for name in FIELDS:
        if name not in document:
            refuse(name, "is missing")
    for name in document:
        if name not in FIELDS:
            refuse(name, "is unknown to this version")

    period_s = document["sample_period_s"]
    if not isinstance(period_s, float) or not 0 < period_s < math.inf:
        refuse("sample_period_s", "is not a positive time")
    for name, kind in (("model_sha256", str), ("report", dict), ("weights", dict)):
        if not isinstance(document[name], kind):
            refuse(name, f"is not a {kind.__name__}")
    matrices = {}
    for name in "ABCD":
        try:
            matrices[name] = np.array(document[name], dtype=float)
        except (TypeError, ValueError):
            refuse(name, "is not a matrix of numbers")
        if not np.isfinite(matrices[name]).all():
            refuse(name, "holds a value that is not finite")
    order = len(matrices["A"]) if matrices["A"].ndim else 0
    shapes = {"A": (order, order), "B": (order, 1), "C": (1, order), "D": (1, 1)}
    for name, shape in shapes.items():
        if matrices[name].shape != shape:
            refuse(name, f"is {matrices[name].shape}, not {shape}")
    return FeedbackController(sample_period_s=period_s, report=document["report"],
                              weights=document["weights"], model_sha256=document["model_sha256"],
                              **matrices)


def load_stabilising_controller(path, model, tick_s, clock_period_s):
    """Read a controller file for use with a model.

    Parameters
    ----------
    path : path-like
    model : piezo_models.cascade.StageModel
    tick_s, clock_period_s : float
        Of the stage (s).

    Returns
    -------
    FeedbackController

    Raises
    ------
    ControllerFileError
        See `load_controller`; or the controller is for another tick, or does not stabilise the
        model.
    """
    controller = load_controller(path)
    if not math.isclose(controller.sample_period_s, tick_s, rel_tol=1e-6):
        raise ControllerFileError(
            f"{path}: sample_period_s is {controller.sample_period_s:g}, but the stage's tick is "
            f"{tick_s:g} s; design the controller with as many samples per tick as the stage has")
    try:
        check_stabilises(controller, model, clock_period_s)
    except UnstableLoop as reason:
        raise ControllerFileError(f"{path}: {reason}") from None
    return controller
