# SPDX-License-Identifier: BSD-3-Clause
"""From a model of several axes and what is said of a path to its plan."""

from collections.abc import Sequence
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from piezo_controller.axes.coupled_inverse import GAIN_LIMIT
from piezo_controller.axes.path_plan import SLEW_LIMIT_V_PER_S, PathPlan, plan_path
from piezo_controller.axes.patterns import ScanPattern, scan_path
from piezo_controller.axes.scan_path import ScanPath
from piezo_controller.axes.spec_path import path_of_spec, spec_of_file
from piezo_controller.references.kind import InvalidReference
from piezo_models.axes.coupled import CoupledModel
from piezo_models.axes.identified_axes import IdentifiedAxes
from piezo_models.axes_model_file import load_axes_model


def scan(model: CoupledModel | IdentifiedAxes | str | PathLike[str], pattern: Any = "raster", *,
         axes: Sequence[str] = (), voltage_range_v: ArrayLike | None = None,
         slew_limit_v_per_s: float = SLEW_LIMIT_V_PER_S, gain_limit: float = GAIN_LIMIT,
         sensor_delay_s: ArrayLike | None = None, **fields: Any) -> PathPlan:
    """Plan the voltages by which several axes follow a path, and predict how well they do.

    Parameters
    ----------
    model : CoupledModel, IdentifiedAxes or path-like
    pattern : str, scanspec.specs.Spec or piezo_controller.axes.scan_path.ScanPath
        ``raster``, ``spiral``, ``lissajous``, ``rosette``, ``cycloid``, ``points``, ``file``, or
        ``scanspec`` (a file); a specification of scanspec; or a path.
    axes : sequence of str, optional
        Axes that a pattern moves, the fast one first; by default the first two of the model.
    voltage_range_v : (2,) or (n, 2) array_like, optional
        Voltage range of the amplifier; by default that of the identification.
    slew_limit_v_per_s : float
        Limit of the amplifier.
    gain_limit : float
        Voltage for a displacement, in multiples of that at rest, up to which the model is inverted.
    sensor_delay_s : (n,) array_like, optional
        By how much the reading of each axis of the model is late, for marks and images; that of the
        model by default.
    **fields
        Such as ``size_um``, ``rate_hz``, ``lines``: see `piezo_controller.axes.patterns`.
        ``centre_um`` is the operating point of the model by default.

    Returns
    -------
    PathPlan
        `voltage_v` of one period, `summary`, `prediction`, `plot`, `columns`.

    Raises
    ------
    ValueError
        If the path has no meaning, or is out of reach; the message then names the largest size and
        rate that are in reach.

    Examples
    --------
    Two modes of 300 and 400 Hz, each pushed a little by the other axis:

    >>> import control, numpy, piezo_offline as piezo
    >>> from piezo_models import CoupledModel
    >>> s, push = control.tf("s"), numpy.array([[0.2, 0.006], [-0.005, 0.2]])
    >>> modes = [control.ss(w**2 / (s**2 + 0.02 * w * s + w**2)) for w in (1900.0, 2500.0)]
    >>> stage = control.append(*modes) * control.ss([], [], [], push)
    >>> model = CoupledModel.from_control(control.sample_system(stage, 1e-4), ("x", "y"))
    >>> plan = piezo.scan(model, "spiral", size_um=(5, 5), rate_hz=100, lines=10)
    >>> plan
    <PathPlan: spiral of 5 x 5 um at 100 Hz, 4400 samples>
    >>> bool(max(plan.prediction.error_percent["coupled"]) < 0.01)
    True
    >>> piezo.scan(model, "spiral", rate_hz=100, lines=10, voltage_range_v=(-9, 9))
    Traceback (most recent call last):
    piezo_controller.axes.path_plan.UnreachablePath: the axes cannot follow the spiral of 10 x 10 um
    at 100 Hz: it takes x voltages from -23.65 to 23.65 V, available are -9 to 9 V; within reach are
    3.63 x 3.63 um at this rate, and no rate at this size
    """
    if isinstance(model, str | PathLike):
        model = load_axes_model(model)
    coupled = model.model if isinstance(model, IdentifiedAxes) else model
    path = pattern if isinstance(pattern, ScanPath) else _drawn(
        coupled, pattern, tuple(axes) or coupled.axes[:2], fields)
    return plan_path(path, model, voltage_range_v, slew_limit_v_per_s, gain_limit, sensor_delay_s)


def _drawn(model: CoupledModel, pattern: Any, axes: tuple[str, ...],
           fields: dict[str, Any]) -> ScanPath:
    if pattern == "scanspec":
        pattern = spec_of_file(fields.pop("file"))
    if hasattr(pattern, "calculate"):
        try:
            return path_of_spec(pattern, model.sample_period_s, **fields)
        except TypeError:
            raise InvalidReference("a path of scanspec has its own sizes and lines: give rate_hz "
                                   "and flyback_s only") from None
    if "centre_um" not in fields and set(axes) <= set(model.axes):
        fields["centre_um"] = tuple(np.array(model.operating_displacement_um)[
            [model.axes.index(axis) for axis in axes]])
    return scan_path(ScanPattern(pattern, **fields), model.sample_period_s, axes)
