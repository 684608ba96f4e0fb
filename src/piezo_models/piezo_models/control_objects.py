# SPDX-License-Identifier: BSD-3-Clause
"""Convert the linear part of a model to an object of python-control or MATLAB, and back."""

import warnings
from collections.abc import Iterable, Sequence
from dataclasses import replace
from os import PathLike
from typing import NamedTuple

import control
import numpy as np
from scipy.io import savemat

from piezo_common.arrays import ComplexArray
from piezo_models.cascade import StageModel
from piezo_models.effects.delay import Delay
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics, zoh

ROUNDING = 1e-9
"""A root is taken as real if its imaginary part is below this fraction of its magnitude;
eigenvalue solvers leave rounding errors of this size."""
RESPONSE_TOLERANCE = 1e-6
"""Largest relative deviation of the found model's response from that of the system, and of the
roots of a delay; a thousandth of what an identification attains."""

AT_ONCE = control.tf([1.0], [1.0])
"""Transfer function of no delay."""

IN_LINEAR = ("modes", "linear")
"""Places of the effects that are part of `StageModel.linear`."""


class LinearParts(NamedTuple):
    """Components of a system of python-control."""

    creep: CreepDynamics
    dynamics: ElectricVibrationDynamics

    gain: float
    """Gain that remains when creep has unit high-frequency gain and dynamics unit DC gain; it
    belongs to the hysteresis."""
    delay_s: float
    """Delay of the Pade approximation in the system, in s; 0 without one."""


class LeftOut(UserWarning):
    """Warning that nonlinear parts of a model are omitted from its linear system."""


def to_control(model: StageModel, sample_period_s: float | None = None, lags: bool = True,
               ) -> control.StateSpace:
    """Return the linear part of a model as a system of python-control.

    The hysteresis is not in it. Other nonlinear parts are omitted and named in a `LeftOut` warning.

    Parameters
    ----------
    sample_period_s : float, optional
        Sample the system exactly for an input held for this period; continuous by default.
    lags : bool
        Include the lags in front of the hysteresis and behind the stage, which a feedback loop
        contains: amplifier, sensor, and a delay by its Pade approximation.

    Returns
    -------
    control.StateSpace
        System from ``hysteresis_um`` to ``displacement_um``.

    Examples
    --------
    >>> from piezo_models import PreisachModel
    >>> line = PreisachModel.line(0.0, 10.0, 2.0)
    >>> dynamics = ElectricVibrationDynamics(1e-3, (1257.0,), (0.02,))
    >>> stage = StageModel(line, CreepDynamics(), dynamics)
    >>> to_control(stage).poles().round(1)
    array([  -25.1+1256.7j,   -25.1-1256.7j, -1000. +0.j ])
    """
    system = model.linear()
    nonlinear = [effect for effect in model.effects if effect.place not in IN_LINEAR]
    found = {index: effect.lag() for index, effect in enumerate(nonlinear)} if lags else {}
    for lag in found.values():
        system = system if lag is None else lag * system
    left_out = [effect.name for index, effect in enumerate(nonlinear) if found.get(index) is None]
    left_out += [name for name, part in (("hysteretic_creep", model.hysteretic_creep),
                                         ("first_rise", model.first_rise)) if part is not None]
    if left_out:
        warnings.warn(f"not part of the linear system: {', '.join(left_out)}", LeftOut,
                      stacklevel=2)
    sampled = system if sample_period_s is None else zoh(system, sample_period_s)
    return control.ss(sampled, inputs=["hysteresis_um"], outputs=["displacement_um"])


def write_matlab(path: str | PathLike[str], model: StageModel) -> None:
    """Write a model for MATLAB, version 5 of its files; an existing file is replaced.

    ``ss(A, B, C, D)`` is the continuous system of `to_control`, which warns of the parts that it
    omits. ``hysteresis`` is the Preisach model: its voltage range, the density in um/V^2 over the
    upper (rows) and lower thresholds, the reversible part in um/V, and the offset in um.
    """
    system, hysteresis = to_control(model), model.hysteresis
    parts = {name: getattr(hysteresis, name) for name in (
        "voltage_min_v", "voltage_max_v", "density_um_per_v2", "reversible_um_per_v", "offset_um")}
    savemat(path, {**{name: np.asarray(getattr(system, name)) for name in "ABCD"},
                   "hysteresis": parts}, appendmat=False)


def with_linear_part(model: StageModel, system: control.StateSpace | control.TransferFunction,
                     ) -> StageModel:
    """Return a model with another linear part; the inverse of ``to_control(lags=False)``.

    The hysteresis is scaled by the gain of the system. Effects at other places are kept, except a
    delay if the system has one. Raises ValueError if `from_control` rejects the system.
    """
    parts = from_control(system)
    delay = (Delay(parts.delay_s),) if parts.delay_s else ()
    stays = tuple(effect for effect in model.effects if effect.place not in IN_LINEAR
                  and not (delay and isinstance(effect, Delay)))
    return replace(model, hysteresis=model.hysteresis.scaled(parts.gain), creep=parts.creep,
                   dynamics=parts.dynamics, effects=(*stays, *delay))


def from_control(system: control.StateSpace | control.TransferFunction) -> LinearParts:
    """Return creep, dynamics, gain and delay of a system of python-control.

    Each real zero belongs to creep (4.4), together with one of the slowest real poles. The next
    real pole is the electric lag; complex pairs are modes and antiresonances (4.3). Two further
    real poles form an overdamped mode. Zeros in the right half-plane are accepted if they belong to
    the Pade approximation of a delay, of any order.

    Parameters
    ----------
    system : control.StateSpace or control.TransferFunction
        Continuous, stable, with one input and one output, without other right half-plane zeros.

    Raises
    ------
    ValueError
        If the system cannot be split into these parts.

    Examples
    --------
    >>> import control
    >>> lag_and_mode = control.tf([3.0], [0.001, 1.0]) * control.tf([1e6], [1.0, 200.0, 1e6])
    >>> delay = control.tf(*control.pade(2e-5, 3))
    >>> parts = from_control(delay * lag_and_mode)
    >>> print(f"{parts.gain:.3f}, {parts.dynamics.time_constant_s:.4f} s, {parts.delay_s:.3g} s")
    3.000, 0.0010 s, 2e-05 s
    """
    if (system.ninputs, system.noutputs) != (1, 1):
        raise ValueError(f"the system has {system.ninputs} inputs and {system.noutputs} outputs; "
                         "give one with a single input and output")
    if not system.isctime(strict=False):
        raise ValueError("the system is discrete; give the continuous one")
    delay_s, delay, poles, zeros = _delay_apart(system.poles(), system.zeros())
    real_poles, modes = _sorted_roots(poles, "pole")
    real_zeros, antiresonances = _sorted_roots(zeros, "zero")
    if len(real_zeros) > len(real_poles):
        raise ValueError(f"the system has {len(real_zeros)} real zeros and {len(real_poles)} real "
                         "poles; creep has one of each, give a pole for every zero")
    fast = real_poles[len(real_zeros):]
    lag, overdamped = (fast[:1], fast[1:]) if len(fast) % 2 else ([], fast)
    modes += [(np.sqrt(p * q), (p + q) / (2.0 * np.sqrt(p * q)))
              for p, q in zip(overdamped[::2], overdamped[1::2], strict=True)]
    creep = CreepDynamics(tuple(real_poles[:len(real_zeros)]), tuple(real_zeros))
    dynamics = ElectricVibrationDynamics(
        1.0 / lag[0] if lag else 0.0, *_columns(modes), *_columns(antiresonances))
    return LinearParts(creep, dynamics, _gain(system, creep, dynamics, delay), delay_s)


def _delay_apart(poles: ComplexArray, zeros: ComplexArray,
                 ) -> tuple[float, control.TransferFunction, ComplexArray, ComplexArray]:
    """Return the delay whose Pade approximation has the right half-plane zeros; the other roots."""
    right = zeros[zeros.real > 0.0]
    order = right.size
    if not order:
        return 0.0, AT_ONCE, poles, zeros
    # The sum of the roots of the approximation's numerator.
    delay_s = float(order * (order + 1) / right.sum().real)
    delay = control.tf(*control.pade(delay_s, order))
    rest_of_poles, rest_of_zeros = _without(poles, delay.poles()), _without(zeros, delay.zeros())
    if rest_of_poles is None or rest_of_zeros is None:
        return 0.0, AT_ONCE, poles, zeros
    return delay_s, delay, rest_of_poles, rest_of_zeros


def _without(roots: ComplexArray, known: ComplexArray) -> ComplexArray | None:
    """Return the roots without the known ones, or None if one of these is not among them."""
    for root in known:
        distance = np.abs(roots - root)
        if not roots.size or distance.min() > RESPONSE_TOLERANCE * abs(root):
            return None
        roots = np.delete(roots, distance.argmin())
    return roots


def _sorted_roots(roots: Iterable[complex], kind: str,
                  ) -> tuple[list[float], list[tuple[float, float]]]:
    """Return the rates of real roots, ascending, and frequency and damping of each complex pair."""
    real, pairs = [], []
    for root in sorted(roots, key=abs):
        if not (np.isfinite(root) and root.real < 0.0):
            raise ValueError(f"the system has a {kind} at {root:.6g} rad/s; "
                             "give a stable one with all zeros on the left")
        if abs(root.imag) <= ROUNDING * abs(root):
            real.append(float(-root.real))
        elif root.imag > 0.0:
            pairs.append((float(abs(root)), float(-root.real / abs(root))))
    return real, pairs


def _columns(pairs: Sequence[tuple[float, float]],
             ) -> tuple[tuple[float, ...], tuple[float, ...]]:
    return tuple(first for first, _ in pairs), tuple(second for _, second in pairs)


def _gain(system: control.StateSpace | control.TransferFunction, creep: CreepDynamics,
          dynamics: ElectricVibrationDynamics, delay: control.TransferFunction) -> float:
    corners = np.array([*creep.poles_rad_per_s, *dynamics.mode_frequencies_rad_per_s, 1.0])
    rates = np.geomspace(corners.min() / 10.0, corners.max() * 10.0, 20)
    frequency_hz = rates / (2.0 * np.pi)
    found = creep.response(frequency_hz) * dynamics.response(frequency_hz)
    ratio = system(1j * rates) / (found * delay(1j * rates))
    gain = float(np.mean(ratio.real))
    if not np.all(np.abs(ratio - gain) <= RESPONSE_TOLERANCE * abs(gain)):
        raise ValueError("the system's poles and zeros cannot be separated well enough; "
                         "give a smaller one, such as control.minreal(system)")
    return gain
