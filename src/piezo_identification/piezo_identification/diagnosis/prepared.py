# SPDX-License-Identifier: BSD-3-Clause
"""A recording prepared for many simulations of a model with one effect or another."""

from dataclasses import replace
from functools import cached_property

import numpy as np

from piezo_identification.diagnosis.noise import repeated_period
from piezo_identification.prediction import mean_zoh, starting_past_v
from piezo_identification.sensitivities import factor_surfaces, sensitivity_systems
from piezo_identification.settling import settling_time_s
from piezo_identification.waveforms import played, samples_per_mean
from piezo_models.linear import equilibrium_state, simulate_linear

MIDDLE_KNOTS, SPAN_KNOTS = 3, 4
"""Of the surface by which the density of a retuned model is multiplied."""

TUNING_WIDTH = 0.005
"""To which the parameters of dynamics and density are known, as a logarithm."""
CREEP_WIDTH = 0.05
"""The same of the creep's rates and sizes."""
REVERSIBLE_WIDTH = 0.02
"""The same of the part of the gain that is reversible: small loops alone tell it from the rest."""

FEWEST_SAMPLES = 500

KEPT_ANSWERS = 3


class PreparedRecording:
    """The part of a recording in which a waveform plays, and a model's answer to it.

    Parameters
    ----------
    model : StageModel
    recording : Recording

    Raises
    ------
    ValueError
        If the recording has gaps, or is too short.
    """

    def __init__(self, model, recording):
        part = played(recording)
        self.path = recording.path
        self.model = model
        self.sample_period_s = part.sample_period_s
        self.samples_per_mean = samples_per_mean(part)
        self.time_s = part.time_s - part.time_s[0]
        self.voltage_v = np.ascontiguousarray(part.voltage_v, dtype=float)
        self.measured_um = np.ascontiguousarray(part.displacement_um, dtype=float)
        self._before_v = recording.select(
            recording.sample_index <= part.sample_index[0]
        ).voltage_v
        self.begin = int(np.searchsorted(self.time_s, settling_time_s(model.dynamics)))
        if self.time_s.size - self.begin < FEWEST_SAMPLES:
            raise ValueError(
                f"{self.path} has {self.time_s.size} samples, fewer than {FEWEST_SAMPLES} after "
                "the start has settled: record longer"
            )
        self._past_v = starting_past_v(model, recording)
        self._answers = {}
        hysteresis_um, rest_hysteresis_um = self._input_of_linear(self.voltage_v)
        self._hysteresis_um = hysteresis_um
        self._answers[(), ()] = self._respond(model.linear(), hysteresis_um)
        self.rest_um = self._answers[(), ()][0] - (hysteresis_um[0] - rest_hysteresis_um)

    def _hysteresis(self, hysteresis, voltage_v):
        """Output while the waveform plays, and at the first sample of the recording."""
        memory = hysteresis.memory()
        hysteresis.simulate(self._past_v, memory)
        before_um = hysteresis.simulate(self._before_v, memory)
        return hysteresis.simulate(voltage_v, memory), before_um[0]

    def _input_of_linear(self, voltage_v):
        """The same of the model, with its hysteretic creep and the effects it has already."""
        model = self.model
        voltage_v = model.amplified(voltage_v, self.sample_period_s)
        output_um, rest_um = self._hysteresis(model.hysteresis, voltage_v)
        if model.hysteretic_creep is not None:
            past = model.hysteresis.memory()
            model.hysteresis.simulate([*self._past_v, *self._before_v], past)
            memory = model.memory(hysteresis=past).hysteretic_creep
            output_um += model.hysteretic_creep.simulate(voltage_v, self.sample_period_s, memory)
        return output_um, rest_um

    def _respond(self, system, input_um):
        return simulate_linear(
            mean_zoh(system, self.sample_period_s, self.samples_per_mean), input_um,
            equilibrium_state(system, input_um[0]),
        )

    def simulate(self, effects=(), quick=()):
        """Displacement that the model with these effects besides its own would measure, (N,).

        Parameters
        ----------
        effects : sequence of piezo_models.effects.effect.Effect
        quick : sequence of piezo_models.effects.effect.Effect
            Those among them that may act on the sampled displacement where they are linear. That
            is a little less exact than a system in series with the others, and much faster.
        """
        on_voltage = tuple(effect for effect in effects if effect.place == "voltage")
        in_series = tuple(
            effect for effect in effects
            if effect.place == "modes" or effect.place == "linear" and effect not in quick
        )
        displacement_um = self._answer(on_voltage, in_series)
        for place in ("linear", "displacement", "sensor"):
            for effect in effects:
                if effect.place == place and effect not in in_series:
                    displacement_um = effect.apply(
                        displacement_um, self.sample_period_s, self.rest_um
                    )
        return self.model.sensed(displacement_um, self.sample_period_s)

    @cached_property
    def repeated_period(self):
        """Samples after which the voltage repeats, once the start has settled; or None."""
        return repeated_period(self.voltage_v[self.begin :])

    @cached_property
    def drive_um(self):
        """What drives the modes of vibration: the displacement if they followed at once, (N,)."""
        lag = type(self.model.dynamics)(self.model.dynamics.time_constant_s)
        without_modes = replace(self.model, dynamics=lag, effects=self.model.effects_at("linear"))
        return self._respond(without_modes.linear(), self._hysteresis_um)

    def _answer(self, on_voltage, in_series):
        """Output of the linear part, kept for the next time."""
        key = on_voltage, in_series
        if key not in self._answers:
            hysteresis_um = self._hysteresis_um
            if on_voltage:
                voltage_v = self.voltage_v
                for effect in on_voltage:
                    voltage_v = effect.apply(voltage_v, self.sample_period_s, self._before_v[0])
                hysteresis_um, _ = self._input_of_linear(voltage_v)
            linear = replace(self.model, effects=(*self.model.effects, *in_series)).linear()
            # A fit tries many; the first and the last few are worth the memory.
            while len(self._answers) > KEPT_ANSWERS:
                del self._answers[list(self._answers)[1]]
            self._answers[key] = self._respond(linear, hysteresis_um)
        return self._answers[key]

    def free_columns(self, rows):
        """What the recording does not tell: the offset, and how far the creep had come.

        Parameters
        ----------
        rows : array of int
            Samples.

        Returns
        -------
        (n, 1 + creep pairs) array
        """
        rates = list(self.model.creep.poles_rad_per_s)
        if self.model.hysteretic_creep is not None:
            rates += [1.0 / tau for tau in set(self.model.hysteretic_creep.time_constants_s)]
        time_s = self.time_s[rows]
        return np.column_stack([np.ones(rows.size), *(np.exp(-p * time_s) for p in rates)])

    def tuning_columns(self, rows):
        """Changes of the displacement with the model's parameters, each within what it is known to.

        Returns
        -------
        (n, parameters) array
            For the changes that `retuned` takes.
        """
        model = self.model
        linear = model.linear()
        columns = [
            self._respond(sensitivity * linear, self._hysteresis_um)[rows]
            for sensitivity in sensitivity_systems(model.creep, model.dynamics)
        ]
        for surface in _surfaces(model):
            part = _times(replace(model.hysteresis, offset_um=0.0), surface)
            output_um, _ = self._hysteresis(part, self.voltage_v)
            columns.append(self._respond(linear, output_um)[rows])
        more_reversible, _ = self._hysteresis(_traded(model.hysteresis, 1.0), self.voltage_v)
        columns.append(self._respond(linear, more_reversible - self._hysteresis_um)[rows])
        return np.column_stack(columns) @ _tuning_map(model)


def _tuning_map(model):
    """Logarithms of the factors of the parameters, for a change of each by one width.

    Pole and zero of a creep pair lie so close that their common place is one quantity, and how much
    creeps between them another: both are known to a few percent, their distance is not free.
    """
    pairs = len(model.creep.poles_rad_per_s)
    dynamics = model.dynamics
    others = (
        (dynamics.time_constant_s > 0.0) + 2 * len(dynamics.mode_frequencies_rad_per_s)
        + 2 * len(dynamics.antiresonance_frequencies_rad_per_s) + len(_surfaces(model)) + 1
    )
    tuning = TUNING_WIDTH * np.eye(2 * pairs + others)
    tuning[-1, -1] = REVERSIBLE_WIDTH
    for pair, (pole, zero) in enumerate(zip(
        model.creep.poles_rad_per_s, model.creep.zeros_rad_per_s, strict=True
    )):
        tuning[[pair, pairs + pair], pair] = CREEP_WIDTH
        tuning[pairs + pair, pairs + pair] = CREEP_WIDTH * (zero - pole) / zero
    return tuning


def _surfaces(model):
    return factor_surfaces(
        model.hysteresis.density_um_per_v2.shape[0], MIDDLE_KNOTS, SPAN_KNOTS
    )


def retuned(model, changes):
    """The model with its parameters changed by factors.

    Parameters
    ----------
    model : StageModel
    changes : (n,) array
        In widths, in the order of `PreparedRecording.tuning_columns`.

    Returns
    -------
    StageModel
    """
    changes = _tuning_map(model) @ changes
    used = 0

    def factors(values):
        nonlocal used
        used += len(values)
        return tuple(np.array(values) * np.exp(changes[used - len(values) : used]))

    creep = type(model.creep)(
        factors(model.creep.poles_rad_per_s), factors(model.creep.zeros_rad_per_s)
    )
    dynamics = model.dynamics
    lag = (dynamics.time_constant_s,) if dynamics.time_constant_s > 0.0 else ()
    lag = factors(lag)
    dynamics = type(dynamics)(
        lag[0] if lag else 0.0, factors(dynamics.mode_frequencies_rad_per_s),
        factors(dynamics.damping_ratios), factors(dynamics.antiresonance_frequencies_rad_per_s),
        factors(dynamics.antiresonance_damping_ratios),
    )
    surface = 1.0 + np.tensordot(changes[used:-1], _surfaces(model), axes=1)
    hysteresis = _times(model.hysteresis, np.maximum(surface, 0.0))
    hysteresis = _traded(hysteresis, changes[-1])
    return replace(model, creep=creep, dynamics=dynamics, hysteresis=hysteresis)


def _traded(hysteresis, part):
    """The hysteresis with a part of its gain over the whole range made reversible."""
    low_um, high_um = hysteresis.output_range_um
    gain_um_per_v = (high_um - low_um) / (hysteresis.voltage_max_v - hysteresis.voltage_min_v)
    return replace(
        hysteresis, density_um_per_v2=hysteresis.density_um_per_v2 * (1.0 - part),
        reversible_um_per_v=np.maximum(
            hysteresis.reversible_um_per_v * (1.0 - part) + part * gain_um_per_v, 0.0),
    )


def _times(hysteresis, surface):
    """The hysteresis with its density, and its reversible part on the diagonal, multiplied."""
    return replace(
        hysteresis, density_um_per_v2=hysteresis.density_um_per_v2 * surface,
        reversible_um_per_v=hysteresis.reversible_um_per_v * np.diagonal(surface),
    )
