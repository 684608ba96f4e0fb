# SPDX-License-Identifier: BSD-3-Clause
"""The six makes: nominal for seed 0, with random parameters for other seeds."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_identification.experiments.stage_limits import StageLimits
from piezo_studies.other_makes.hystereses import JilesAtherton, MaxwellSlip, Plays
from piezo_studies.other_makes.linear_system import (
    LinearSystem,
    Stage,
    coupled_flexures,
    fractional_creep,
    lag,
    logarithmic_creep,
    mode,
    power_creep,
)

ANY_SLEW_V_PER_S = 1e9
"""Slew limit of the makes, which has no effect."""


@dataclass(frozen=True)
class Make:
    """A stage with its instruments and its true parameters."""

    name: str
    stage: Stage
    limits: StageLimits

    noise_um: float
    """Standard deviation of the sensor's white noise."""
    true: dict[str, list[float]] = field(repr=False)
    """True values of parameters that the models have, too, by their names: frequencies and dampings
    of the modes, `delay_s`, `front_lag_s` before the hysteresis, and `behind_lag_s` after it.
    Parameters without a counterpart are missing."""
    drift_um: float = 0.0
    drift_s: float = 200.0
    """Standard deviation and correlation time of the sensor's drift."""
    is_swept: bool = False
    """Whether its dynamics are recorded with a chirp instead of a square wave."""

    @property
    def first_mode_hz(self) -> float:
        """Lowest frequency of a mode."""
        return min(self.true["mode_frequencies_rad_per_s"]) / (2.0 * np.pi)


class Draw:
    """Random parameters about their nominal values; the seed 0 gives the nominal ones."""

    def __init__(self, seed: int) -> None:
        self._random = np.random.default_rng(seed) if seed else None

    def about(self, value: float, part: float = 0.2) -> float:
        """Return a value within a factor of e^-part to e^part."""
        return value if self._random is None else (
            value * float(np.exp(self._random.uniform(-part, part))))


def limits(low_v: float, high_v: float, rate_hz: float) -> StageLimits:
    """Return limits with a voltage range and a sample rate."""
    return StageLimits(low_v, high_v, ANY_SLEW_V_PER_S, rate_hz,
                       rest_voltage_v=min(max(0.0, low_v), high_v))


def true_modes(system: LinearSystem) -> dict[str, list[float]]:
    """Return frequencies and dampings of the modes of a system, the slowest first."""
    poles = sorted((pole for pole in system.poles_per_s if pole.imag > 0.0), key=abs)
    return {"mode_frequencies_rad_per_s": [float(abs(pole)) for pole in poles],
            "damping_ratios": [float(-pole.real / abs(pole)) for pole in poles]}


def two_modes(draw: Draw, share: float, first: tuple[float, float],
              second: tuple[float, float]) -> LinearSystem:
    """Draw two parallel modes of given frequency (rad/s) and damping; `share` is the second's."""
    share = draw.about(share)
    return mode(draw.about(first[0]), draw.about(first[1]), 1.0 - share).parallel_to(
        mode(draw.about(second[0]), draw.about(second[1]), share))


def plays_15um(seed: int = 0) -> Make:
    """Draw a stage with asymmetric plays, logarithmic creep, and two parallel modes."""
    draw = Draw(seed)
    modes = two_modes(draw, 0.15, (1200.0, 0.02), (1900.0, 0.015))
    return _asymmetric("plays_15um", draw, modes)


def opposite_lag(seed: int = 0) -> Make:
    """Draw a stage like `plays_15um`, with one mode and a small parallel lag of opposite sign."""
    draw = Draw(seed)
    share = draw.about(0.06)
    modes = mode(draw.about(1192.0), draw.about(0.02), 1.0 + share).parallel_to(
        lag(draw.about(3e-4), -share))
    return _asymmetric("opposite_lag", draw, modes, has_lag_behind=True)


def _asymmetric(name: str, draw: Draw, modes: LinearSystem, has_lag_behind: bool = False) -> Make:
    front_lag_s = draw.about(5e-5)
    widths_v = np.linspace(0.0, draw.about(20.0), 12)
    weights = np.append(0.75, 0.05 * np.exp(-widths_v[1:] / 12.0))
    hysteresis = Plays(widths_v, 15.0 / 112.0 * weights / weights.sum(), (1.0, 1.2e-3),
                       (1.02, 1.0e-3))
    creep = logarithmic_creep(draw.about(0.012))
    true = true_modes(modes) | {"front_lag_s": [front_lag_s], "delay_s": [0.0]}
    if not has_lag_behind:
        true["behind_lag_s"] = [0.0]
    return Make(name, Stage(hysteresis, creep.then(modes), lag(front_lag_s)),
                limits(0.0, 100.0, 20e3), 1e-3, true)


def tube_11um(seed: int = 0) -> Make:
    """Draw a tube scanner with power-law creep, a second-order amplifier, and a chirp."""
    draw = Draw(seed)
    modes = two_modes(draw, 0.1, (3400.0, 0.012), (6100.0, 0.02))
    widths_v = np.linspace(0.0, draw.about(70.0), 15)
    weights = np.append(0.7, np.full(14, 0.035))
    curve = (1.0, 0.0, 2e-6)
    hysteresis = Plays(widths_v, 11.0 / 330.0 * weights / weights.sum(), curve, curve)
    creep = power_creep(draw.about(0.02), draw.about(0.15))
    return Make("tube_11um", Stage(hysteresis, creep.then(modes),
                                   mode(draw.about(15e3), draw.about(0.75, 0.1))),
                limits(-150.0, 150.0, 100e3), 4e-4, true_modes(modes), is_swept=True)


def maxwell_300um(seed: int = 0) -> Make:
    """Draw a stage with Maxwell's slip, two coupled flexures, and a drifting strain gauge."""
    draw = Draw(seed)
    modes = flexures(draw, 45.0, 0.03)
    front_lag_s = draw.about(8e-4)
    hysteresis = slipping(draw, 300.0 / 150.0, 60.0)
    creep = logarithmic_creep(draw.about(0.010))
    return Make("maxwell_300um", Stage(hysteresis, creep.then(modes), lag(front_lag_s)),
                limits(0.0, 150.0, 2e3), 0.015,
                true_modes(modes) | {"front_lag_s": [front_lag_s], "delay_s": [0.0]},
                drift_um=0.1)


def small_2um(seed: int = 0) -> Make:
    """Draw a small and fast stage with a delay of some samples."""
    draw = Draw(seed)
    modes = two_modes(draw, 0.2, (32e3, 0.012), (51e3, 0.015))
    front_lag_s, delay_s = draw.about(3e-6), draw.about(6.8e-6)
    hysteresis = slipping(draw, 2.0 / 140.0, 50.0)
    creep = logarithmic_creep(draw.about(0.012), fastest_s=1e-4)
    return Make("small_2um", Stage(hysteresis, creep.then(modes), lag(front_lag_s), delay_s),
                limits(-20.0, 120.0, 500e3), 5e-5,
                true_modes(modes) | {"front_lag_s": [front_lag_s], "delay_s": [delay_s],
                                     "behind_lag_s": [0.0]})


def fractional(seed: int = 0) -> Make:
    """Draw a stage with fractional creep, pinned domains, coupled flexures and a sensor lag."""
    draw = Draw(seed)
    modes = flexures(draw, 260.0, 0.0)
    front_lag_s, behind_lag_s = draw.about(6e-5), draw.about(1.5e-4)
    hysteresis = JilesAtherton(0.22, draw.about(10.0), draw.about(35.0), draw.about(12.0), 0.5,
                               0.2, 50.0)
    creep = fractional_creep(draw.about(0.08), draw.about(20.0), draw.about(0.4))
    behind = creep.then(modes).then(lag(behind_lag_s))
    return Make("fractional", Stage(hysteresis, behind, lag(front_lag_s)),
                limits(0.0, 100.0, 10e3), 3e-3,
                true_modes(modes) | {"front_lag_s": [front_lag_s], "delay_s": [0.0],
                                     "behind_lag_s": [behind_lag_s]})


def slipping(draw: Draw, gain_um_per_v: float, longest_v: float) -> MaxwellSlip:
    """Return blocks that slip after voltage changes up to `longest_v`, with a sixth of the gain."""
    limits_v = np.geomspace(1.0, draw.about(longest_v), 14)
    stiffnesses = gain_um_per_v * draw.about(0.17) * np.full(14, 1.0 / 14.0)
    return MaxwellSlip(gain_um_per_v, stiffnesses, 0.5 * limits_v, 6e-4)


def flexures(draw: Draw, frequency_hz: float, direct: float) -> LinearSystem:
    """Return two coupled bodies, the first on flexures, with the sensor at the second."""
    w = 2.0 * np.pi * draw.about(frequency_hz)
    mass = np.diag([1.0, draw.about(0.35)])
    coupling = draw.about(1.4) * w**2
    stiffness = np.array([[1.6 * w**2 + coupling, -coupling], [-coupling, coupling]])
    damping: FloatArray = draw.about(0.018) / w * stiffness + draw.about(0.01) * w * mass
    return coupled_flexures(mass, damping, stiffness, np.array([1.0, 0.0]),
                            np.array([0.0, 1.0]), direct)


MAKES: dict[str, Callable[[int], Make]] = {
    make.__name__: make for make in (
        plays_15um, tube_11um, opposite_lag, maxwell_300um, small_2um, fractional)}
"""Functions of a seed that return the makes, by name."""
