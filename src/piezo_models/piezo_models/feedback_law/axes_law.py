# SPDX-License-Identifier: BSD-3-Clause
"""A feedback of several axes as its design leaves it, and the law file that holds it."""

from dataclasses import dataclass
from os import PathLike
from typing import Any, ClassVar

import numpy as np
from pydantic import model_validator

from piezo_common.arrays import FloatArray
from piezo_common.schema import (
    Document,
    Number,
    Numbers,
    Positive,
    SchemaError,
    entry,
    load_document,
    require_matrices,
    violation,
)
from piezo_common.text_file import replace_document
from piezo_models.feedback_law.feedback_law import DeclaredPlant, FeedbackLaw, LinearBlock

FORMAT, VERSION = "piezo_stage_law", 1

FADE_S = 0.02
"""Time over which the initial error is faded in (s), as for a law of one axis."""


class LawFileError(ValueError):
    """A law file that cannot be read or written; the message gives path, field and cure."""


@dataclass(frozen=True, eq=False)
class AxesLaw:
    """A feedback of several axes for a stage that evaluates it, without the path of a run."""

    axes: tuple[str, ...]
    sample_period_s: float
    """Period of the stage's sample clock (s)."""
    samples_per_tick: int

    tick: LinearBlock
    """From the mean errors of a tick (um) to the voltages of the next one (V)."""
    observer: FloatArray
    """See `FeedbackLaw`, (n, axes)."""
    plant: DeclaredPlant

    operating_displacement_um: FloatArray
    """Displacement at which paths begin and end, (axes,)."""
    report: dict[str, Any]
    """Numbers and texts that describe the loop, see `design_axes_feedback`."""
    weights: dict[str, Any]
    """Weights that it was designed with, in the layout of the weights file."""
    model_sha256: str = ""
    """Hash of the model file that it was designed for; empty if the model came from no file."""

    def following(self, once_um: FloatArray, period_um: FloatArray, start_sample: int,
                  max_feedback_v: float) -> FeedbackLaw:
        """Return the law of a run along a path; for the expected displacements see `FeedbackLaw`.

        The stage stops if an error grows by more than the largest voltage of each axis, of either
        sign, could correct. Nothing is fed back before the start sample of the run.
        """
        return FeedbackLaw(
            self.tick, self.observer, max_feedback_v, once_um, period_um, self.plant, start_sample,
            max_error_um=max_feedback_v * float(self.plant.gains_um_per_v.min()),
            fade_samples=round(FADE_S / self.sample_period_s), axes=self.axes)


class LawDocument(Document):
    """The law file: the feedback of several axes, and the plant that it was designed for."""

    TITLE: ClassVar[str] = "law file"
    FORMAT: ClassVar[str] = FORMAT
    VERSION: ClassVar[int] = VERSION
    RENEW: ClassVar[str] = "design the feedback again"

    format: str = entry(f"Always {FORMAT}.")
    version: Number = entry(f"Always {VERSION}.")
    axes: list[str] = entry("Names of the axes.", shortest=2)
    sample_period_s: Positive = entry("Period of the stage's sample clock.", unit="s")
    samples_per_tick: Positive = entry("Samples of a tick.")
    A: list[Numbers] = entry("System matrix at the tick's rate, n x n.")
    B: list[Numbers] = entry("Input matrix; the inputs are the mean errors of a tick (um).")
    C: list[Numbers] = entry("Output matrix; the outputs are the voltages of the next tick (V).")
    D: list[Numbers] = entry("Direct part.", unit="V/um")
    observer: list[Numbers] = entry(
        "Corrects the state by the voltages that limits cut off, n x axes.", unit="1/V")
    model_a: list[Numbers] = entry("System matrix of the plant at the sample rate.")
    model_b: list[Numbers] = entry("Its input matrix; the inputs are voltages times gains (um).")
    model_c: list[Numbers] = entry("Its output matrix; the outputs are displacements (um).")
    model_gains_um_per_v: list[Numbers] = entry(
        "Gains of the axes at which the loop is stable, a row for each combination.", unit="um/V")
    operating_displacement_um: Numbers = entry("Displacement where paths begin.", unit="um")
    model_sha256: str = entry("Hash of the model file that it was designed for, or empty.")
    report: dict[str, Any] = entry("What is known of the loop; not checked.")
    weights: dict[str, Any] = entry("Weights of the design; not checked.")

    @model_validator(mode="after")
    def _check_shapes(self) -> "LawDocument":
        n, order, model_order = len(self.axes), len(self.A), len(self.model_a)
        require_matrices(self, {
            "A": (order, order), "B": (order, n), "C": (n, order), "D": (n, n),
            "observer": (order, n), "model_a": (model_order, model_order),
            "model_b": (model_order, n), "model_c": (n, model_order),
            "model_gains_um_per_v": (len(self.model_gains_um_per_v), n)}, self.RENEW)
        if len(self.operating_displacement_um) != n:
            raise violation(f"has not {n} numbers", self.RENEW, "operating_displacement_um")
        return self


def save_axes_law(path: str | PathLike[str], law: AxesLaw) -> None:
    """Write a law file; an existing file is replaced completely or not at all.

    Raises `LawFileError` if the file cannot be written, exists and is not a law file, or the law
    holds a value that is not finite.
    """
    linear = law.plant.linear
    matrices = {"A": law.tick.a, "B": law.tick.b, "C": law.tick.c, "D": law.tick.d,
                "observer": law.observer, "model_a": linear.a, "model_b": linear.b,
                "model_c": linear.c, "model_gains_um_per_v": law.plant.gains_um_per_v,
                "operating_displacement_um": law.operating_displacement_um}
    document = {"format": FORMAT, "version": VERSION, "axes": law.axes,
                "sample_period_s": law.sample_period_s, "samples_per_tick": law.samples_per_tick,
                "model_sha256": law.model_sha256, "report": law.report, "weights": law.weights,
                **{name: np.asarray(values).tolist() for name, values in matrices.items()}}
    replace_document(path, document, "law file", LawFileError)


def load_axes_law(path: str | PathLike[str]) -> AxesLaw:
    """Read a law file.

    Raises `LawFileError` if the file is missing, is not a law file of this version, or has a
    missing, unknown or invalid field.
    """
    try:
        document = load_document(LawDocument, path)
    except SchemaError as error:
        raise LawFileError(f"{path}: {error}") from None
    n = len(document.axes)
    return AxesLaw(
        tuple(document.axes), document.sample_period_s, round(document.samples_per_tick),
        LinearBlock.of(document.A, document.B, document.C, document.D, n),
        np.array(document.observer),
        DeclaredPlant(LinearBlock.of(document.model_a, document.model_b, document.model_c,
                                     np.zeros((n, n)), n),
                      np.array(document.model_gains_um_per_v)),
        np.array(document.operating_displacement_um), document.report, document.weights,
        document.model_sha256)
