# SPDX-License-Identifier: BSD-3-Clause
"""Random effects, scaled to a given contribution to a record.

The shape of an effect is drawn from the seed; its strength follows from the wanted contribution.
"""

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.optimize import brentq
from scipy.signal import lfilter

from piezo_sim.effects.ambient_temperature import ThermalDrift
from piezo_sim.effects.current_limit import CurrentLimit
from piezo_sim.effects.depolarisation import Depolarisation
from piezo_sim.effects.distributed_lag import DistributedLag
from piezo_sim.effects.guide_spring import GuideSpring
from piezo_sim.effects.intermittent_contact import IntermittentContact
from piezo_sim.effects.logarithmic_creep import LogarithmicCreep
from piezo_sim.effects.mains_hum import MainsHum
from piezo_sim.effects.parallel_mode import ParallelMode
from piezo_sim.effects.placement import add_effect
from piezo_sim.effects.self_heating import SelfHeating
from piezo_sim.effects.soft_backlash import SoftBacklash
from piezo_sim.effects.soft_saturation import SoftSaturation
from piezo_sim.effects.spikes import Spikes
from piezo_sim.effects.switching_delay import SwitchingDelay
from piezo_sim.effects.transducer_curve import TransducerCurve
from piezo_sim.effects.transport_delay import TransportDelay
from piezo_sim.plant.linear_effects import VibrationMode
from piezo_sim.plant.plant import Plant
from piezo_sim.plant.plant_effect import Effect, Surroundings
from piezo_sim.plant.plant_file import PlantConfig
from piezo_sim.plant.sensor import DisplacementSensor


class DrawError(ValueError):
    """The record cannot show the effect with the wanted contribution."""


@dataclass(frozen=True)
class DrawnEffect:
    """An effect with the wanted contribution."""

    cause: str
    """Kind of the effect, a key of `CAUSES` or of `CAUSES_OUTSIDE`."""
    effect: Effect
    """The effect with its parameters."""
    contribution_rms_um: float
    """RMS of its contribution to the measured displacement, without the mean."""
    plant: PlantConfig
    """The plant with the effect."""


@dataclass(frozen=True)
class _Record:
    """The record for which the shape of an effect is drawn."""

    voltage_v: np.ndarray
    displacement_um: np.ndarray
    sample_period_s: float
    rest_voltage_v: float
    clock_samples: int
    modes: tuple[VibrationMode, ...]

    @property
    def duration_s(self) -> float:
        return self.voltage_v.size * self.sample_period_s

    @property
    def travel_um(self) -> float:
        return float(np.abs(np.diff(self.displacement_um)).sum())

    def position_um(self, share: float) -> float:
        """Return the displacement at a fraction of its range."""
        return float(self.displacement_um.min() + share * np.ptp(self.displacement_um))


# A family returns the effect for a strength; the contribution grows with the strength.
Family = Callable[[float], Effect]


def _log_uniform(random: np.random.Generator, low: float, high: float) -> float:
    return math.exp(random.uniform(math.log(low), math.log(high)))


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _creep(random, record) -> Family:
    onset_s = _log_uniform(random, 0.01, 0.3)
    memory_s = _log_uniform(random, 300.0, 3000.0)
    return lambda strength: LogarithmicCreep(strength, onset_s, memory_s)


def _thermal_drift(random, record) -> Family:
    time_constant_s = record.duration_s * _log_uniform(random, 0.1, 3.0)
    start = random.uniform(-2.0, 2.0) * math.sqrt(time_constant_s)
    expansion = _log_uniform(random, 0.05, 0.3)
    return lambda strength: ThermalDrift(expansion, strength * start, strength, time_constant_s)


def _vibration_mode(random, record) -> Family:
    frequency_hz = random.uniform(1100.0, 2000.0)
    damping_ratio = _log_uniform(random, 0.005, 0.03)
    sign = random.choice([-1.0, 1.0])
    return lambda strength: ParallelMode(
        2.0 * math.pi * frequency_hz, damping_ratio, float(sign * strength), 2
    )


def _delay(random, record) -> Family:
    return TransportDelay


def _sensor_lag(random, record) -> Family:
    sections = int(random.integers(3, 7))
    return lambda strength: DistributedLag(strength, sections)


def _sensor_nonlinearity(random, record) -> Family:
    centre_um = record.position_um(random.uniform(0.3, 0.7))
    range_um = float(np.ptp(record.displacement_um))
    return lambda strength: TransducerCurve(centre_um, range_um / strength)


def _periodic_disturbance(random, record) -> Family:
    frequency_hz = 50.0 * (1.0 + 0.001 * random.standard_normal())
    harmonics = np.array([1.0, random.uniform(0.0, 0.4), random.uniform(0.0, 0.3)])
    walk = _log_uniform(random, 0.01, 0.1)
    return lambda strength: MainsHum(frequency_hz, tuple(map(float, strength * harmonics)), walk)


def _slew_limit(random, record) -> Family:
    capacitance_f = _log_uniform(random, 1e-6, 1e-5)
    growth_per_v = random.uniform(0.0, 0.004)
    asymmetry = random.uniform(0.8, 1.25)

    def limit(strength):
        current_a = capacitance_f / strength
        return CurrentLimit(current_a, asymmetry * current_a, capacitance_f, growth_per_v)

    return limit


def _voltage_clipping(random, record) -> Family:
    knee_v = random.uniform(0.3, 2.0)
    # The upper limit may lie from well above to below all voltages; the lower one is never reached.
    top_v = float(record.voltage_v.max()) + 20.0 * knee_v
    bottom_v = min(float(record.voltage_v.min()), record.rest_voltage_v) - 10.0 * knee_v
    return lambda strength: SoftSaturation(
        bottom_v - 30.0 * knee_v, max(top_v - strength, bottom_v), knee_v
    )


def _rate_dependent_hysteresis(random, record) -> Family:
    averaging_s = max(_log_uniform(random, 3e-4, 3e-3), record.sample_period_s)
    decay = math.exp(-record.sample_period_s / averaging_s)
    speed_v_per_s = lfilter([1.0 - decay], [1.0, -decay], np.diff(record.voltage_v))
    typical_v_per_s = _rms(speed_v_per_s) / record.sample_period_s or 1.0
    reference = typical_v_per_s * _log_uniform(random, 0.03, 0.3)
    return lambda strength: SwitchingDelay(strength, reference, averaging_s)


def _stiffening(random, record) -> Family:
    relaxed_um = record.position_um(random.uniform(0.0, 0.3))
    range_um = float(np.ptp(record.displacement_um))
    # The sensor measures the guided part, so the spring is that of the last mode.
    mode = record.modes[-1]
    return lambda strength: GuideSpring(
        mode.frequency_rad_per_s, mode.damping_ratio, relaxed_um, range_um / strength)


def _backlash(random, record) -> Family:
    return SoftBacklash


def _outliers(random, record) -> Family:
    seen_per_s = max(_log_uniform(random, 1.0, 20.0), 10.0 / record.duration_s)
    rate_per_s = seen_per_s * record.clock_samples
    spread = random.uniform(0.2, 0.6)
    return lambda strength: Spikes(rate_per_s, strength, spread)


def _self_heating(random, record) -> Family:
    cooling_s = record.duration_s * _log_uniform(random, 0.05, 0.5)
    share = cooling_s / record.duration_s
    heating_k_per_um = 10.0 / max(record.travel_um * share, 1e-9)
    return lambda strength: SelfHeating(heating_k_per_um, cooling_s, -strength)


def _intermittent_contact(random, record) -> Family:
    tight_s = record.duration_s * _log_uniform(random, 0.03, 0.15)
    loose_s = record.duration_s * _log_uniform(random, 0.03, 0.15)
    joint_um = record.position_um(random.uniform(-0.2, 0.2))
    return lambda strength: IntermittentContact(strength, joint_um, tight_s, loose_s)


def _depolarisation(random, record) -> Family:
    travel_um = max(record.travel_um, 1e-9) * random.uniform(0.3, 1.0)
    return lambda strength: Depolarisation(strength, travel_um)


@dataclass(frozen=True)
class _Recipe:
    """Family of an effect, and bounds of its strength."""

    family: Callable[[np.random.Generator, _Record], Family]
    weakest: float
    strongest: float


# Effects that a diagnosis should name, by this name.
CAUSES = {
    "creep": _Recipe(_creep, 1e-7, 0.1),
    "thermal_drift": _Recipe(_thermal_drift, 1e-6, 1e3),
    "vibration_mode": _Recipe(_vibration_mode, 1e-7, 0.5),
    "delay": _Recipe(_delay, 1e-9, 1e-2),
    "sensor_lag": _Recipe(_sensor_lag, 1e-8, 3e-2),
    "sensor_nonlinearity": _Recipe(_sensor_nonlinearity, 1e-4, 3.0),
    "periodic_disturbance": _Recipe(_periodic_disturbance, 1e-6, 10.0),
    "slew_limit": _Recipe(_slew_limit, 1e-9, 0.05),
    "voltage_clipping": _Recipe(_voltage_clipping, 1e-3, 1e3),
    "rate_dependent_hysteresis": _Recipe(_rate_dependent_hysteresis, 1e-7, 20.0),
    "stiffening": _Recipe(_stiffening, 1e-4, 3.0),
    "backlash": _Recipe(_backlash, 1e-7, 20.0),
    "outliers": _Recipe(_outliers, 1e-6, 1e3),
}
# Effects outside the list, which a diagnosis should report as unexplained.
CAUSES_OUTSIDE = {
    "self_heating": _Recipe(_self_heating, 1e-8, 0.05),
    "intermittent_contact": _Recipe(_intermittent_contact, 1e-7, 0.5),
    "depolarisation": _Recipe(_depolarisation, 1e-7, 0.5),
}


def respond(
    plant: PlantConfig, voltage_v: np.ndarray, surroundings: Surroundings, clock_samples: int
) -> np.ndarray:
    """Simulate a plant at a multiple of the sample rate; return its displacement, (N,).

    Each voltage is held for `clock_samples` of the stage's clock, so that motion between slow
    samples acts, such as the response to a jump. The surroundings have the sample period of the
    record.
    """
    clock_s = surroundings.sample_period_s / clock_samples
    clock = dataclasses.replace(surroundings, sample_period_s=clock_s)
    held_v = np.repeat(np.asarray(voltage_v, dtype=np.float64), clock_samples)
    measured_um, _ = Plant(plant, clock).respond(held_v)
    return measured_um[::clock_samples]


def response_um(
    plant: PlantConfig, voltage_v: np.ndarray, surroundings: Surroundings, clock_samples: int = 1
) -> np.ndarray:
    """Return the measured displacement without noise and quantization; see `respond`."""
    sensor = tuple(
        dataclasses.replace(effect, noise_rms_um=0.0, converter_bits=32)
        if isinstance(effect, DisplacementSensor)
        else effect
        for effect in plant.sensor
    )
    quiet = dataclasses.replace(plant, sensor=sensor)
    return respond(quiet, voltage_v, surroundings, clock_samples)


def draw_effect(
    cause: str,
    plant: PlantConfig,
    voltage_v: np.ndarray,
    surroundings: Surroundings,
    noise_multiple: float,
    seed: int,
    clock_samples: int = 1,
) -> DrawnEffect:
    """Draw an effect that contributes a multiple of the sensor's noise to a record, within 1 %.

    The contribution is compared by its RMS, without its mean. The plant may already have drawn
    effects; the voltages, (N,), and the surroundings are those with which the record will be
    played. DrawError is raised if no strength of the effect gives this contribution.
    """
    recipe = (CAUSES | CAUSES_OUTSIDE)[cause]
    without_um = response_um(plant, voltage_v, surroundings, clock_samples)
    record = _Record(
        np.asarray(voltage_v),
        without_um,
        surroundings.sample_period_s,
        surroundings.rest_voltage_v,
        clock_samples,
        tuple(effect for effect in plant.stage if isinstance(effect, VibrationMode)),
    )
    family = recipe.family(np.random.default_rng([seed, *cause.encode()]), record)
    noise_um = next(e.noise_rms_um for e in plant.sensor if isinstance(e, DisplacementSensor))
    wanted_um = noise_multiple * noise_um

    @cache
    def drawn(log_strength):
        effect = family(math.exp(log_strength))
        with_it = add_effect(plant, effect)
        added_um = response_um(with_it, voltage_v, surroundings, clock_samples) - without_um
        added_um -= added_um.mean()
        return DrawnEffect(cause, effect, _rms(added_um), with_it)

    def excess(log_strength):
        return math.log(max(drawn(log_strength).contribution_rms_um, 1e-12) / wanted_um)

    low, high = math.log(recipe.weakest), math.log(recipe.strongest)
    for end, fits in ((low, excess(low) <= 0.0), (high, excess(high) >= 0.0)):
        if not fits:
            raise DrawError(
                f"{cause}: this record shows it with {drawn(end).contribution_rms_um:.3g} um at "
                f"the {'weakest' if end == low else 'strongest'}, not with {wanted_um:.3g} um; "
                "choose another record or another multiple of the noise."
            )
    return drawn(brentq(excess, low, high, xtol=2e-4, rtol=1e-6))
