# SPDX-License-Identifier: BSD-3-Clause
"""Model files of one axis or of several."""

from os import PathLike

from piezo_models.axes.identified_axes import IdentifiedAxes
from piezo_models.axes_model_file import load_axes_model, save_axes_model
from piezo_models.identified_model import IdentifiedModel
from piezo_models.model_file import is_of_several_axes
from piezo_models.model_file import load_model as load_model_of_one_axis
from piezo_models.model_file import save_model as save_model_of_one_axis


def load_model(path: str | PathLike[str]) -> IdentifiedModel | IdentifiedAxes:
    """Read a model file, of one axis or of several.

    Raises
    ------
    piezo_models.ModelFileError
        If the file is missing, is not a model file of this version, or has an invalid field.

    Examples
    --------
    >>> load_model("not_there.json")
    Traceback (most recent call last):
        ...
    piezo_models.model_document.ModelFileError: not_there.json: cannot be read ...
    """
    return load_axes_model(path) if is_of_several_axes(path) else load_model_of_one_axis(path)


def save_model(path: str | PathLike[str], identified: IdentifiedModel | IdentifiedAxes) -> None:
    """Write a model file; the file at `path` is replaced in one step or not at all.

    Raises
    ------
    piezo_models.ModelFileError
        If the file cannot be written, or a file that is not a model file is in its place.

    Examples
    --------
    >>> from piezo_models import (
    ...     CreepDynamics, ElectricVibrationDynamics, IdentifiedModel, PreisachModel, StageModel)
    >>> line = PreisachModel.line(0.0, 10.0, 2.0)
    >>> stage = StageModel(line, CreepDynamics(), ElectricVibrationDynamics())
    >>> save_model("line.json", IdentifiedModel(stage, voltage_range_v=(0.0, 10.0)))
    >>> load_model("line.json").voltage_range_v
    (0.0, 10.0)
    """
    if not isinstance(path, str | PathLike):
        raise TypeError(f"the path is a {type(path).__name__}: give the path first, as in "
                        'save_model("model.json", model)')
    if isinstance(identified, IdentifiedAxes):
        save_axes_model(path, identified)
    elif isinstance(identified, IdentifiedModel):
        save_model_of_one_axis(path, identified)
    else:
        raise TypeError(f"{type(identified).__name__} is no identified model: give that of "
                        "identify or extend")
