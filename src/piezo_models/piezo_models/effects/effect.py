# SPDX-License-Identifier: BSD-3-Clause
"""What every effect that may extend the cascade has in common."""

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, ClassVar, Self, TypeVar

import control
import numpy as np

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import ElectricVibrationDynamics

PLACES = ("voltage", "modes", "linear", "displacement", "sensor")
"""An effect acts on the voltage before the hysteresis; beside the modes of vibration; as a
linear system behind them; on the displacement; or on what the sensor makes of it. They are in the
order of the signal."""

Candidate = TypeVar("Candidate")
AnyEffect = TypeVar("AnyEffect", bound="Effect")

LEAST, MOST = 1e-15, 1e15
"""Bounds of times, rates, lengths and voltages that are positive, in their units. No stage comes
near them, on whatever scale of time: recordings bound what a fit may take, by `Effect.bounds`."""

INVERSION_ROUNDS = 50
INVERSION_TOLERANCE = 1e-9


def parameter(unit: str, scale: str = "linear", low: float = -np.inf, high: float = np.inf,
              default: Any = dataclasses.MISSING) -> Any:
    """Declare a parameter of an effect.

    Parameters
    ----------
    scale : str
        In which it is fitted: "linear", "logarithm" for one that is positive, or "fixed".
    low, high : float
        Bounds.
    """
    return dataclasses.field(
        default=default,
        metadata={"unit": unit, "scale": scale, "low": float(low), "high": float(high)}
    )


ROUNDING = 1e-9
"""Part of a displacement up to which it has not moved: of a range so small no shape is known."""


@dataclass(frozen=True)
class Evidence:
    """What a recording shows of a model's error: from it an effect guesses its parameters.

    Attributes
    ----------
    voltage_v : (N,) array
    displacement_um : (N,) array
        Of the model.
    residual_um : (N,) array
        Measured minus simulated, after what a retuned model explains.
    noise_um : float
        Standard deviation of the noise of a sample.
    dynamics : ElectricVibrationDynamics
        Of the model.
    drive_um : (N,) array
        What drives the modes: the displacement if they followed at once.
    reduction : callable
        Given contributions, shape (N, n): the gains that fit them best to the residual, and the
        part of its energy that they remove. With `positive=True` no gain is negative.
    visible : callable
        Given a contribution, shape (N, 1): the part of its variation that neither offset nor
        initial creep nor a retuned model could explain.
    measured_um : (N,) array, optional
        As the sensor read it.
    """

    sample_period_s: float
    voltage_v: FloatArray
    displacement_um: FloatArray
    residual_um: FloatArray
    noise_um: float
    dynamics: ElectricVibrationDynamics
    drive_um: FloatArray
    reduction: Callable[..., tuple[FloatArray, float]]
    visible: Callable[[FloatArray], float]
    measured_um: FloatArray | None = None

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
        """Choose the candidates whose contributions remove most of the residual.

        Parameters
        ----------
        contributions : callable
            Gives the contributions, shape (N, n), of a candidate.

        Returns
        -------
        list of (candidate, gains)
            The best first.
        """
        tried = [(candidate, *self.reduction(contributions(candidate))) for candidate in candidates]
        tried.sort(key=lambda entry: -entry[2])
        return [(candidate, gains) for candidate, gains, _ in tried[:count]]


@dataclass(frozen=True)
class Extent:
    """How far recordings go: it bounds what the parameters of an effect can physically be.

    Attributes
    ----------
    travel_um : float
        Largest minus smallest measured displacement.
    lowest_v, highest_v : float
        Of the voltage.
    """

    travel_um: float
    lowest_v: float
    highest_v: float
    duration_s: float
    sample_period_s: float

    @property
    def span_v(self) -> float:
        """Return the highest minus lowest voltage."""
        return self.highest_v - self.lowest_v


@dataclass(frozen=True)
class Effect(ABC):
    """An effect with its parameters: a frozen dataclass whose fields are made by `parameter`.

    Attributes
    ----------
    place : str
        One of `PLACES`.
    several : bool
        A stage may have more than one.
    follows_voltage : bool
        False for what comes from outside, at times of its own.
    of_the_stage : bool
        False for what depends on when a recording begins: its parameters hold for one recording.
    recurs : bool
        Of what is not of the stage: where it goes on, every recording has one of its own, a sum of
        what `recurrence` returns.
    remembers : bool
        False where every sample depends on itself alone.
    experiment : str
        What to play so that the effect shows.
    distortion : frozenset of str or None
        Of a multisine of odd lines: "odd" where the effect always has odd distortion, both where it
        has "even" or "odd" one, and none where it is linear. None where it is not known.
    indistinguishable_from : tuple of str
        Names of effects that do much the same to most recordings. Where the diagnosis finds one of
        two, it also tries the other in its place. One of the two is enough to name the other.
    same_without_dynamics : tuple of str
        Names of effects of which a form that acts at once does exactly the same. Their candidates
        are of another form, so a diagnosis that finds this one lists them.
    """

    name: ClassVar[str]
    place: ClassVar[str]
    several: ClassVar[bool] = False
    follows_voltage: ClassVar[bool] = True
    of_the_stage: ClassVar[bool] = True
    recurs: ClassVar[bool] = False
    remembers: ClassVar[bool] = True
    experiment: ClassVar[str]
    distortion: ClassVar[frozenset[str] | None] = None
    indistinguishable_from: ClassVar[tuple[str, ...]] = ()
    same_without_dynamics: ClassVar[tuple[str, ...]] = ()

    @abstractmethod
    def apply(self, signal: FloatArray, sample_period_s: float,
              rest: float | None = None) -> FloatArray:
        """Return the signal behind the effect.

        Parameters
        ----------
        signal : (N,) array
            Voltage in V or displacement in um, at its `place`.
        rest : float, optional
            Level at which the signal has rested before; its first value by default.

        Returns
        -------
        (N,) array
        """

    def advance(self, signal: FloatArray, sample_period_s: float,
                past: Any = None) -> tuple[FloatArray, Any]:
        """Return the next part of the signal behind the effect, and what is remembered after it.

        The parts joined are what `apply` makes of the joined signal.

        Parameters
        ----------
        signal : (N,) array
            Not empty.
        sample_period_s : float
            The same for all parts.
        past : object, optional
            Returned with the part before, and not changed; at first there is none.

        Returns
        -------
        behind : (N,) array
        past : object
            By default the whole signal so far, to which the effect is applied anew: an effect that
            remembers less has an `advance` of its own.
        """
        if not self.remembers:
            return self.apply(signal, sample_period_s), None
        whole = signal if past is None else np.concatenate([past, signal])
        return self.apply(whole, sample_period_s)[whole.size - signal.size :], whole

    def acts_at_once(self, sample_period_s: float) -> bool:
        """Tell whether every sample depends on itself and on its time alone."""
        del sample_period_s
        return not self.remembers

    def compensate(self, wanted: FloatArray, sample_period_s: float) -> FloatArray:
        """Return the periodic signal in front of the effect that gives the wanted one behind it.

        Parameters
        ----------
        wanted : (N,) array
            One period.

        Returns
        -------
        (N,) array

        Raises
        ------
        ValueError
            If there is none.
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
        raise ValueError(f"no signal gives the wanted one through {self.name}: ask for less")

    def lag(self) -> control.StateSpace | None:
        """Return what a feedback loop meets of the effect; None if it lags nothing.

        Returns
        -------
        control.StateSpace or None
            Continuous.
        """
        return None

    def state_space(self) -> control.StateSpace:
        """Return the system of an effect whose place is "linear" or "modes".

        Returns
        -------
        control.StateSpace
            Continuous: that of the whole effect, or of the mode alone with unit gain at rest.

        Raises
        ------
        NotImplementedError
            If the effect acts elsewhere.
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
    def is_indistinguishable_from(cls, other: type["Effect"]) -> bool:
        """Return whether this effect names the other as indistinguishable, or the other this one.

        Parameters
        ----------
        other : type
            Another effect.
        """
        return other.name in cls.indistinguishable_from or cls.name in other.indistinguishable_from

    @classmethod
    @abstractmethod
    def starts(cls, evidence: Evidence) -> list[Self]:
        """Guess effects to begin a fit from by a recording; none if nothing hints at one."""

    @classmethod
    def lacks_excitation(cls, evidence: Evidence) -> str | None:
        """Tell why a recording cannot show the effect; None if it can."""
        return None

    @classmethod
    def bounds(cls, extent: Extent) -> dict[str, tuple[float, float]]:
        """Bound what the parameters can physically be in recordings that go so far.

        Returns
        -------
        dict of str to (float, float)
            Least and largest value of each parameter that the recordings bound more closely than
            its declaration does.
        """
        return {}

    def recurrence(self, time_s: FloatArray, duration_s: float) -> FloatArray:
        """Return the signals that sum up to what the effect adds to any other recording.

        Parameters
        ----------
        time_s : (n,) array
            Of some samples of that recording, from its first one on.
        duration_s : float
            Of that recording.

        Returns
        -------
        (n, k) array
            None of them for an effect that does not recur.
        """
        return np.zeros((time_s.size, 0))

    def hysteresis_ahead(self, hysteresis: PreisachModel) -> PreisachModel | None:
        """Return the hysteresis that, with the effect behind it, does what the given one does.

        A model that was identified with the effect in the stage has the given one.

        Returns
        -------
        PreisachModel or None
            None where no hysteresis does what the effect does, which holds by default.
        """
        return None

    def impossible(self, extent: Extent) -> str | None:
        """Tell why no stage can have the effect with these parameters; None if one can."""
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
    """List the numbers that a fit may change, logarithms where the parameter is fitted as one.

    Parameters
    ----------
    extent : Extent, optional
        Of the recordings, which bound the parameters by `Effect.bounds`.

    Returns
    -------
    values, low, high : (n,) arrays
        Each value within its bounds.
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
    """List the unit of each number of `fitted_values`, None where it is fitted as a logarithm."""
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
