# SPDX-License-Identifier: BSD-3-Clause
"""A model as a .mat file: its linear part as matrices, its hysteresis as a density."""

from os import PathLike
from typing import TYPE_CHECKING

import numpy as np
from scipy.io import savemat

if TYPE_CHECKING:
    from piezo_models.cascade import StageModel


def write_matlab(path: str | PathLike[str], model: "StageModel") -> None:
    """Write a model for MATLAB, version 5 of its files; an existing file is replaced.

    ``ss(A, B, C, D)`` is the continuous system of `piezo_models.control_objects.to_control`, which
    warns of the parts that it omits. ``hysteresis`` is the Preisach model: its voltage range, the
    density in um/V^2 over the upper (rows) and lower thresholds, the reversible part in um/V, and
    the offset in um.
    """
    from piezo_models.control_objects import to_control

    system, hysteresis = to_control(model), model.hysteresis
    parts = {name: getattr(hysteresis, name) for name in (
        "voltage_min_v", "voltage_max_v", "density_um_per_v2", "reversible_um_per_v", "offset_um")}
    savemat(path, {**{name: np.asarray(getattr(system, name)) for name in "ABCD"},
                   "hysteresis": parts}, appendmat=False)
