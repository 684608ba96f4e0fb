# SPDX-License-Identifier: BSD-3-Clause
"""The common base of all effects that may extend the cascade."""

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, ClassVar, Self, TypeVar

import control
import numpy as np
from numpy.typing import ArrayLike

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import ElectricVibrationDynamics

PLACES = ("voltage", "modes", "linear", "displacement", "sensor")
"""Places of effects in the order of the signal: on the voltage before the hysteresis; in parallel
with the modes of vibration; as a linear system behind them; on the displacement; on the measured
displacement."""

Candidate = TypeVar("Candidate")
AnyEffect = TypeVar("AnyEffect", bound="Effect")

LEAST, MOST = 1e-15, 1e15
"""Bounds of positive times, rates, lengths and voltages in their units. No stage comes near them
on any time scale; `Effect.bounds` gives the closer bounds of a fit."""

INVERSION_ROUNDS = 50
INVERSION_TOLERANCE = 1e-9


def parameter(unit: str, scale: str = "linear", low: float = -np.inf, high: float = np.inf,
              default: Any = dataclasses.MISSING) -> Any:
    """Declare a parameter of an effect.

    Parameters
    ----------
    scale : str
        Scale of the fit: "linear", "logarithm" for a positive parameter, or "fixed".
    low, high : float
        Bounds in `unit`.
    """
    return dataclasses.field(
        default=default,
        metadata={"unit": unit, "scale": scale, "low": float(low), "high": float(high)}
    )


ROUNDING = 1e-9
"""Fraction of a displacement up to which it counts as constant."""


@dataclass(frozen=True)
class Evidence:
    """Data of a model's error on a recording, from which an effect estimates its parameters."""

    sample_period_s: float

    voltage_v: FloatArray
    """Shape (N,)."""
    displacement_um: FloatArray
    """Displacement of the model, (N,)."""
    residual_um: FloatArray
    """Measured minus simulated displacement, without what a retuned model explains, (N,)."""
    noise_um: float
    """Standard deviation of the noise of a sample."""
    dynamics: ElectricVibrationDynamics
    """Dynamics of the model."""
    drive_um: FloatArray
    """Input of the modes, equal to the displacement if they followed at once, (N,)."""
    reduction: Callable[..., tuple[FloatArray, float]]
    """Given contributions, shape (N, n), returns the gains that fit them best to the residual and
    the fraction of its energy that they remove. With `positive=True` no gain is negative."""
    visible: Callable[[FloatArray], float]
    """Given a contribution, shape (N, 1), returns the fraction of its variation that neither offset
    nor initial creep nor a retuned model can explain."""
    measured_um: FloatArray | None = None
    """Displacement as the sensor measured it, (N,)."""

    @property
    def time_s(self) -> FloatArray:
        """Return the time since the first sample in s, shape (N,)."""
        return np.arange(self.voltage_v.size, dtype=np.float64) * self.sample_period_s

    @property
    def duration_s(self) -> float:
        """Return the duration of the whole recording in s."""
        return self.voltage_v.size * self.sample_period_s

    @property
    def travel_um(self) -> float:
        """Return the largest minus smallest displacement; 0 if the model moves by rounding only."""
        travel_um = float(np.ptp(self.displacement_um))
        return travel_um if travel_um > ROUNDING * np.abs(self.displacement_um).max() else 0.0

    def best(self, candidates: Iterable[Candidate],
             contributions: Callable[[Candidate], FloatArray],
             count: int = 1) -> list[tuple[Candidate, FloatArray]]:
        """Choose the candidates whose contributions, (N, n), remove most of the residual.

        The `count` best are returned with their gains, best first.
        """
        tried = [(candidate, *self.reduction(contributions(candidate))) for candidate in candidates]
        tried.sort(key=lambda entry: -entry[2])
        return [(candidate, gains) for candidate, gains, _ in tried[:count]]


@dataclass(frozen=True)
class Extent:
    """The extent of recordings, which bounds the physically possible parameters of an effect."""

    travel_um: float
    """Largest minus smallest measured displacement."""
    lowest_v: float
    highest_v: float
    """Lowest and highest voltage in V."""
    duration_s: float
    sample_period_s: float

    @property
    def span_v(self) -> float:
        """Return the highest minus lowest voltage."""
        return self.highest_v - self.lowest_v


@dataclass(frozen=True)
class Effect(ABC):
    """An effect with its parameters: a frozen dataclass whose fields are made by `parameter`."""

    name: ClassVar[str]

    place: ClassVar[str]
    """One of `PLACES`."""
    several: ClassVar[bool] = False
    """True if a stage may have more than one."""
    follows_voltage: ClassVar[bool] = True
    """False for disturbances that do not depend on the voltage."""
    of_the_stage: ClassVar[bool] = True
    """False if the effect depends on when a recording begins: its parameters then hold for one
    recording only."""
    recurs: ClassVar[bool] = False
    """For effects that are not of the stage: if it persists, every recording has its own, a
    combination of the signals of `recurrence`."""
    remembers: ClassVar[bool] = True
    """False if every output sample depends only on the same input sample."""
    experiment: ClassVar[str]
    """The experiment that shows the effect."""
    distortion: ClassVar[frozenset[str] | None] = None
    """Distortion of a multisine with odd lines: "odd" if the effect always has odd distortion, both
    if it has "even" or "odd" one, empty if it is linear. None if it is not known."""
    confounded_with: ClassVar[tuple[str, ...]] = ()
    """Names of effects that act alike on most recordings. If the diagnosis finds one of two, it
    also tries the other in its place. It is enough if one names the other."""
    same_without_dynamics: ClassVar[tuple[str, ...]] = ()
    """Names of effects that have an equivalent form without dynamics. Their candidates have another
    form, so a diagnosis that finds this effect lists them."""

    @abstractmethod
    def apply(self, signal: FloatArray, sample_period_s: float,
              rest: float | None = None) -> FloatArray:
        """Return the signal behind the effect, (N,).

        Parameters
        ----------
        signal : (N,) array
            Voltage in V or displacement in um, at its `place`.
        rest : float, optional
            Level at which the signal has rested before; its first value by default.
        """

    def advance(self, signal: FloatArray, sample_period_s: float,
                past: Any = None) -> tuple[FloatArray, Any]:
        """Return the next part of the signal behind the effect, and the memory after it.

        The joined parts equal `apply` of the joined signal.

        Parameters
        ----------
        signal : (N,) array
            Next part of the signal, not empty.
        sample_period_s : float
            Sample period in s, the same for all parts.
        past : object, optional
            Memory that the previous part returned, not changed; None for the first part.

        Returns
        -------
        behind : (N,) array
        past : object
            By default the whole signal so far, to which the effect is applied again. An effect
            that needs less memory overrides `advance`.
        """
        if not self.remembers:
            return self.apply(signal, sample_period_s), None
        whole = signal if past is None else np.concatenate([past, signal])
        return self.apply(whole, sample_period_s)[whole.size - signal.size :], whole

    def memory_after(self, voltage_v: ArrayLike) -> Any:
        """Return the memory for `advance` after earlier voltages, or None without a memory.

        The time between them has no effect: only hysteresis remembers voltages of long ago.
        """
        del voltage_v

    def acts_at_once(self, sample_period_s: float) -> bool:
        """Return True if every sample depends only on itself and on its time."""
        del sample_period_s
        return not self.remembers

    def compensate(self, wanted: FloatArray, sample_period_s: float) -> FloatArray:
        """Return the periodic signal, (N,), that the effect turns into the wanted one.

        Parameters
        ----------
        wanted : (N,) array
            One period.

        Raises
        ------
        ValueError
            If no such signal is found.
        """
        if not self.follows_voltage:
            return wanted
        signal = wanted.copy()
        for _ in range(INVERSION_ROUNDS):
            settled = self.apply(np.tile(signal, 3), sample_period_s)[-wanted.size :]
            missing = wanted - settled
            signal = signal + missing
            if np.abs(missing).max() <= INVERSION_TOLERANCE * np.ptp(wanted):
                return signal
        raise ValueError(f"no signal gives the wanted one through {self.name}: reduce the motion")

    def lag(self) -> control.StateSpace | None:
        """Return the continuous system of the effect's lag in a feedback loop, or None."""
        return None

    def state_space(self) -> control.StateSpace:
        """Return the system of an effect whose place is "linear" or "modes".

        Returns
        -------
        control.StateSpace
            Continuous system of the effect, or of the mode alone with unit DC gain.

        Raises
        ------
        NotImplementedError
            If the effect has another place.
        """
        raise NotImplementedError(f"{self.name} acts on the {self.place}: it is no linear system")

    def response(self, s: ComplexArray) -> ComplexArray:
        """Return the factor by which the effect multiplies the model's frequency response.

        An effect whose place is "linear" has the transfer function of its system. A linear effect
        on the displacement or the sensor gives its own here. Modes of vibration are part of the
        dynamics and enter the response there.

        Parameters
        ----------
        s : (N,) array of complex
            Complex frequency in rad/s, such as 2 pi i f.

        Returns
        -------
        (N,) array of complex
            Ones for an effect that is not linear, as it has no transfer function.
        """
        return self.state_space()(s) if self.place == "linear" else np.ones_like(s)

    @classmethod
    def is_confounded_with(cls, other: type["Effect"]) -> bool:
        """Return whether one of two effects names the other as indistinguishable."""
        return other.name in cls.confounded_with or cls.name in other.confounded_with

    @classmethod
    @abstractmethod
    def starts(cls, evidence: Evidence) -> list[Self]:
        """Estimate initial effects for a fit from a recording; an empty list if none is found."""

    @classmethod
    def lacks_excitation(cls, evidence: Evidence) -> str | None:
        """Return why a recording cannot show the effect; None if it can."""
        return None

    @classmethod
    def bounds(cls, extent: Extent) -> dict[str, tuple[float, float]]:
        """Return what the parameters can physically be in recordings of this extent: (low, high).

        Only parameters whose bounds are closer than declared are in it.
        """
        return {}

    def recurrence(self, time_s: FloatArray, duration_s: float) -> FloatArray:
        """Return signals whose combination is the effect's contribution to another recording.

        Parameters
        ----------
        time_s : (n,) array
            Times of samples of that recording in s, from its first one.
        duration_s : float
            Duration of that recording in s.

        Returns
        -------
        (n, k) array
            One column for each signal; none for an effect that does not recur.
        """
        return np.zeros((time_s.size, 0))

    def hysteresis_ahead(self, hysteresis: PreisachModel) -> PreisachModel | None:
        """Return the hysteresis that is equivalent to the given one if the effect acts behind it.

        The given hysteresis was identified with the effect in the stage. None, the default, says
        that the effect cannot be separated from a hysteresis.
        """
        return None

    def impossible(self, extent: Extent) -> str | None:
        """Return why no stage can have the effect with these parameters; None if one can."""
        return None

    def parameters(self) -> dict[str, Any]:
        """Return the value of each parameter by name; a tuple where it has several."""
        return {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}

    @classmethod
    def units(cls) -> dict[str, str]:
        """Return the unit of each parameter by name."""
        return {field.name: field.metadata["unit"] for field in dataclasses.fields(cls)}

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            numbers = np.atleast_1d(np.asarray(value, dtype=float))
            low, high = field.metadata["low"], field.metadata["high"]
            if not np.isfinite(numbers).all() or (numbers < low).any() or (numbers > high).any():
                raise ValueError(
                    f"{field.name} of {self.name} is {value}; give a number from {low:g} to "
                    f"{high:g}"
                )
            plain = tuple(map(float, value)) if isinstance(value, (tuple, list)) else float(value)
            object.__setattr__(self, field.name, plain)


def fitted_values(effect: Effect, extent: Extent | None = None,
                  ) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the numbers that a fit may change, as logarithms where the parameter is so fitted.

    They are followed by their bounds, all (n,), which the extent of the recordings narrows; see
    `Effect.bounds`. Each value is within its bounds.
    """
    closer = {} if extent is None else effect.bounds(extent)
    values, lows, highs = ([np.zeros(0)] for _ in range(3))
    for field in dataclasses.fields(effect):
        scale, name = field.metadata["scale"], field.name
        if scale == "fixed":
            continue
        numbers = np.atleast_1d(np.asarray(getattr(effect, name), dtype=float))
        declared = field.metadata["low"], field.metadata["high"]
        bounds = np.clip(closer.get(name, declared), *declared)
        numbers = np.clip(numbers, *bounds)
        if scale == "logarithm":
            with np.errstate(divide="ignore"):
                numbers, bounds = np.log(numbers), np.log(np.maximum(bounds, 0.0))
        values.append(numbers)
        lows.append(np.full(numbers.size, bounds[0]))
        highs.append(np.full(numbers.size, bounds[1]))
    return np.concatenate(values), np.concatenate(lows), np.concatenate(highs)


def units_of_fitted(effect: Effect) -> list[str | None]:
    """Return the unit of each number of `fitted_values`, None if it is fitted as a logarithm."""
    units: list[str | None] = []
    for field in dataclasses.fields(effect):
        unit, scale = field.metadata["unit"], field.metadata["scale"]
        if scale != "fixed":
            size = np.atleast_1d(getattr(effect, field.name)).size
            units += [None if scale == "logarithm" else unit] * size
    return units


def with_fitted_values(effect: AnyEffect, values: FloatArray) -> AnyEffect:
    """Return the effect with other values, in the order of `fitted_values`."""
    changes, used = {}, 0
    for field in dataclasses.fields(effect):
        scale, old = field.metadata["scale"], getattr(effect, field.name)
        if scale == "fixed":
            continue
        size = len(old) if isinstance(old, tuple) else 1
        numbers = np.asarray(values[used : used + size], dtype=float)
        if scale == "logarithm":
            numbers = np.exp(numbers)
        numbers = np.clip(numbers, field.metadata["low"], field.metadata["high"])
        changes[field.name] = tuple(numbers) if isinstance(old, tuple) else float(numbers[0])
        used += size
    return dataclasses.replace(effect, **changes)
