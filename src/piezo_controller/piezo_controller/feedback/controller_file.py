# SPDX-License-Identifier: BSD-3-Clause
"""The controller file: one versioned JSON document, written atomically and read strictly."""

import math
from os import PathLike
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from pydantic import model_validator

from piezo_common.schema import (
    Document,
    Number,
    Numbers,
    SchemaError,
    entry,
    load_document,
    require_matrices,
    violation,
)
from piezo_common.text_file import replace_document
from piezo_controller.feedback.feedback_design import (
    FeedbackController,
    UnstableLoop,
    check_stabilises,
)
from piezo_models.cascade import StageModel

FORMAT = "piezo_stage_controller"
VERSION = 1


class ControllerFileError(ValueError):
    """A controller file that cannot be read or written; the message gives path, field and cure."""


class ControllerDocument(Document):
    """The controller file: the state space of a feedback at the tick's rate."""

    TITLE: ClassVar[str] = "controller file"
    FORMAT: ClassVar[str] = FORMAT
    VERSION: ClassVar[int] = VERSION
    RENEW: ClassVar[str] = "design the controller again"

    format: str = entry(f"Always {FORMAT}.")
    version: Number = entry(f"Always {VERSION}.")
    model_sha256: str = entry("Hash of the model file that it was designed for, or empty.")
    sample_period_s: Number = entry("Tick of the stage.", unit="s", above=0.0)
    report: dict[str, Any] = entry(
        "What is known of the loop; not checked, except delay_ticks and hysteresis_gain_um_per_v.")
    weights: dict[str, Any] = entry("Weights of the design; empty for PID; not checked.")
    A: list[Numbers] = entry("System matrix, n x n.")
    B: list[Numbers] = entry("Input matrix, n x 1; the input is the tracking error (um).")
    C: list[Numbers] = entry("Output matrix, 1 x n; the output is the voltage (V).")
    D: list[Numbers] = entry("Direct part, 1 x 1.", unit="V/um")

    @model_validator(mode="after")
    def _check_shapes(self) -> "ControllerDocument":
        order = len(self.A)
        require_matrices(self, {
            "A": (order, order), "B": (order, 1), "C": (1, order), "D": (1, 1)}, self.RENEW)
        return self

    @model_validator(mode="after")
    def _check_report(self) -> "ControllerDocument":
        delay_ticks = self.report.get("delay_ticks", 1)
        if isinstance(delay_ticks, bool) or delay_ticks not in (0, 1):
            raise violation("of the report is not 0 or 1", self.RENEW, "delay_ticks")
        gain = self.report.get("hysteresis_gain_um_per_v", 1.0)
        if isinstance(gain, bool) or not isinstance(gain, int | float) or not 0 < gain < math.inf:
            raise violation("of the report is no positive number", self.RENEW,
                            "hysteresis_gain_um_per_v")
        return self


def save_controller(path: str | Path, controller: FeedbackController) -> None:
    """Write a controller file; an existing file is replaced completely or not at all.

    Raises
    ------
    ControllerFileError
        If the file cannot be written, exists and is not a controller file, or the controller
        holds a value that is not finite.

    Examples
    --------
    >>> import control
    >>> from piezo_controller.feedback.feedback_design import feedback_from_control
    >>> from piezo_models import (
    ...     CreepDynamics, ElectricVibrationDynamics, PreisachModel, StageModel)
    >>> line = PreisachModel.line(0.0, 10.0, 2.0)
    >>> stage = StageModel(line, CreepDynamics(), ElectricVibrationDynamics(1e-3))
    >>> integrator = control.tf([0.05, 0.0], [1.0, -1.0], 1e-3)
    >>> save_controller("integrator.json", feedback_from_control(integrator, stage))
    >>> load_controller("integrator.json").sample_period_s
    0.001
    """
    matrices = {name: np.asarray(getattr(controller, name)).tolist() for name in "ABCD"}
    document = {"format": FORMAT, "version": VERSION, "model_sha256": controller.model_sha256,
                "sample_period_s": controller.sample_period_s, "report": controller.report,
                "weights": controller.weights, **matrices}
    replace_document(path, document, "controller file", ControllerFileError)


def load_controller(path: str | PathLike[str]) -> FeedbackController:
    """Read a controller file.

    Raises `ControllerFileError` if it is missing, is not a controller file of this version, or has
    a missing, unknown or invalid field.

    Examples
    --------
    >>> load_controller("not_there.json")
    Traceback (most recent call last):
        ...
    piezo_controller.feedback.controller_file.ControllerFileError: not_there.json: ...
    """
    try:
        document = load_document(ControllerDocument, path)
    except SchemaError as error:
        raise ControllerFileError(f"{path}: {error}") from None
    order = len(document.A)
    return FeedbackController(
        A=np.reshape(np.array(document.A, dtype=float), (order, order)),
        B=np.reshape(np.array(document.B, dtype=float), (order, 1)),
        C=np.array(document.C, dtype=float), D=np.array(document.D, dtype=float),
        sample_period_s=document.sample_period_s, report=document.report,
        weights=document.weights, model_sha256=document.model_sha256)


def load_stabilising_controller(path: str | Path, model: StageModel, tick_s: float,
                                clock_period_s: float) -> FeedbackController:
    """Read a controller file for use with a model, at the rate of the ticks or of the samples.

    Raises `ControllerFileError` as `load_controller`, and if the controller is for another rate, or
    does not stabilise the model.
    """
    controller = load_controller(path)
    if not any(math.isclose(controller.sample_period_s, period_s, rel_tol=1e-6)
               for period_s in (tick_s, clock_period_s)):
        raise ControllerFileError(
            f"{path}: sample_period_s is {controller.sample_period_s:g}, but the stage's tick is "
            f"{tick_s:g} s and its samples are {clock_period_s:g} s apart; design the controller "
            "with as many samples per tick as the stage has")
    try:
        check_stabilises(controller, model, clock_period_s)
    except UnstableLoop as reason:
        raise ControllerFileError(f"{path}: {reason}") from None
    return controller
