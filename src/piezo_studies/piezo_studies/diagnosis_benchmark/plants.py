# SPDX-License-Identifier: BSD-3-Clause
"""Random plants around the default one."""

from dataclasses import replace

import numpy as np

from piezo_sim.plant.continuous_preisach import PreisachHysteresis
from piezo_sim.plant.linear_effects import Creep, ElectricLag, VibrationMode
from piezo_sim.plant.plant_file import read_plant
from piezo_sim.plant.sensor import DisplacementSensor


def draw_plant(seed):
    """Draw a plant with the default structure and random parameters."""
    random = np.random.default_rng([*seed, *b"plant"])
    plant = read_plant()
    size = _factor(random, 1.8)
    changed = {
        PreisachHysteresis: lambda effect: _hysteresis(effect, random, size),
        Creep: lambda effect: _creep(effect, random),
        ElectricLag: lambda effect: replace(
            effect, time_constant_s=effect.time_constant_s * _factor(random, 1.6)
        ),
        VibrationMode: lambda effect: replace(
            effect,
            frequency_rad_per_s=effect.frequency_rad_per_s * _factor(random, 1.3),
            damping_ratio=effect.damping_ratio * _factor(random, 1.4),
        ),
        DisplacementSensor: lambda effect: replace(
            effect, noise_rms_um=effect.noise_rms_um * size * _factor(random, 1.5),
            displacement_min_um=size * effect.displacement_min_um,
            displacement_max_um=size * effect.displacement_max_um,
        ),
    }
    return replace(plant, **{
        section: tuple(
            changed[type(effect)](effect) if type(effect) in changed else effect
            for effect in getattr(plant, section)
        )
        for section in ("stage", "sensor")
    })


def noise_um(plant):
    """Return the standard deviation of the sensor's noise in a sample."""
    return next(e.noise_rms_um for e in plant.sensor if isinstance(e, DisplacementSensor))


def _factor(random, most):
    """Draw a factor between 1 / `most` and `most`."""
    return float(np.exp(random.uniform(-np.log(most), np.log(most))))


def _hysteresis(effect, random, size):
    width = _factor(random, 1.6)
    return replace(
        effect,
        broad_density_um_per_v2=effect.broad_density_um_per_v2 * size * _factor(random, 2.0),
        # The small-signal gain, which is the integral over the ridge, must not depend on the width.
        ridge_density_um_per_v2=effect.ridge_density_um_per_v2 * size / width,
        ridge_width_v=effect.ridge_width_v * width,
        position_modulation=float(random.uniform(-0.15, 0.25)),
        modulation_centre_v=float(random.uniform(30.0, 70.0)),
        offset_um=effect.offset_um * size,
    )


def _creep(effect, random):
    """Return the creep with random changes of its time scale and amount."""
    poles, zeros = np.array(effect.poles_rad_per_s), np.array(effect.zeros_rad_per_s)
    time, amount = _factor(random, 1.5), _factor(random, 1.6)
    return replace(
        effect,
        poles_rad_per_s=tuple(map(float, poles * time)),
        zeros_rad_per_s=tuple(map(float, (poles + amount * (zeros - poles)) * time)),
    )
