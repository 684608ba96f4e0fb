# SPDX-License-Identifier: BSD-3-Clause
"""A recording prepared for many simulations of a model with one effect or another."""

from dataclasses import replace
from functools import cached_property

import numpy as np

from piezo_identification.conditioning.outlier_samples import OUTLIER, good_samples
from piezo_identification.conditioning.settling import first_settled
from piezo_identification.conditioning.waveforms import (
    played,
    samples_per_mean,
    with_voltage_before,
)
from piezo_identification.diagnosis.noise import repeated_period
from piezo_identification.estimators.frequency_response.sampled_response import (
    behind_lags,
    leading_lags,
    respond,
)
from piezo_identification.estimators.refinement.sensitivities import (
    factor_surfaces,
    sensitivity_systems,
)
from piezo_identification.prediction import starting_past_v
from piezo_models.linear.creep_errors import creep_error_map

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
        With the sign of the model, and its outliers marked.
    past_v : (float, float) or (), optional
        Of the hysteresis before the recording; by default that of `starting_past_v`.

    Raises
    ------
    ValueError
        If the recording has gaps, or is too short.
    """

    def __init__(self, model, recording, past_v=None):
        part = played(recording)
        self.path = recording.path
        self.model = model
        self.sample_period_s = part.sample_period_s
        self.samples_per_mean = samples_per_mean(part)
        self.time_s = part.time_s - part.time_s[0]
        self.voltage_v = np.ascontiguousarray(part.voltage_v, dtype=float)
        self.measured_um = np.ascontiguousarray(part.displacement_um, dtype=float)
        self.outlier = ~good_samples(part)
        self.off_um = part.columns.get(OUTLIER, np.zeros(self.time_s.size))
        self._joined_v, self._lead = with_voltage_before(recording, part)
        self.begin = first_settled(model.dynamics, self.time_s)
        if self.time_s.size - self.begin < FEWEST_SAMPLES:
            raise ValueError(
                f"{self.path} has {self.time_s.size} samples, fewer than {FEWEST_SAMPLES} after "
                "the start has settled: record longer"
            )
        self.past_v = starting_past_v(model, recording) if past_v is None else past_v
        self._answers = {}
        self._amplified_v = model.amplified(self._joined_v, self.sample_period_s)
        self._hysteresis_um, rest_um = self._hysteresis(model.hysteresis, self._amplified_v)
        self._input_um = self._with_creep(self._hysteresis_um, self._amplified_v)
        self.rest_um = self._answer((), (), ())[0] - (self._hysteresis_um[0] - rest_um)

    def _hysteresis(self, hysteresis, amplified_v):
        """Output while the waveform plays, and at the first sample of the recording."""
        memory = hysteresis.memory()
        hysteresis.simulate(self.past_v, memory)
        output_um = hysteresis.simulate(amplified_v, memory)
        return output_um[self._lead :], output_um[0]

    def _with_creep(self, hysteresis_um, amplified_v):
        """Input of the linear part: the output of the hysteresis with its creep."""
        model = self.model
        if model.hysteretic_creep is None:
            return hysteresis_um
        past = model.hysteresis.memory()
        model.hysteresis.simulate([*self.past_v, *amplified_v[: self._lead + 1]], past)
        memory = model.memory(hysteresis=past).hysteretic_creep
        return hysteresis_um + model.hysteretic_creep.simulate(
            amplified_v[self._lead :], self.sample_period_s, memory)

    def _respond(self, system, delay_s, input_um):
        return respond(
            system, input_um, self.sample_period_s, self.samples_per_mean, delay_s)

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
        behind = tuple(
            effect for stage in (effects, self.model.effects)
            for place in ("displacement", "sensor") for effect in stage if effect.place == place
        )
        lags, others = leading_lags(behind, self.samples_per_mean)
        displacement_um = self._answer(on_voltage, in_series, lags)
        quick = tuple(effect for effect in quick if effect.place == "linear")
        for effect in (*quick, *others):
            displacement_um = effect.apply(displacement_um, self.sample_period_s, self.rest_um)
        return displacement_um

    @cached_property
    def repeated_period(self):
        """Samples after which the voltage repeats, once the start has settled; or None."""
        return repeated_period(self.voltage_v[self.begin :])

    @cached_property
    def drive_um(self):
        """What drives the modes of vibration: the displacement if they followed at once, (N,)."""
        lag = type(self.model.dynamics)(self.model.dynamics.time_constant_s)
        without_modes = replace(self.model, dynamics=lag, effects=self.model.effects_at("linear"))
        return self._respond(without_modes.linear(), 0.0, self._input_um)

    def _answer(self, on_voltage, in_series, lags):
        """Output of the linear part and the lags behind it, kept for the next time."""
        key = on_voltage, in_series, lags
        if key not in self._answers:
            input_um = self._input_um
            if on_voltage:
                voltage_v = self._joined_v
                for effect in on_voltage:
                    voltage_v = effect.apply(voltage_v, self.sample_period_s)
                amplified_v = self.model.amplified(voltage_v, self.sample_period_s)
                hysteresis_um, _ = self._hysteresis(self.model.hysteresis, amplified_v)
                input_um = self._with_creep(hysteresis_um, amplified_v)
            linear = replace(self.model, effects=(*self.model.effects, *in_series)).linear()
            # A fit tries many; the first and the last few are worth the memory.
            while len(self._answers) > KEPT_ANSWERS:
                del self._answers[list(self._answers)[1]]
            self._answers[key] = self._respond(*behind_lags(linear, lags), input_um)
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
            self._respond(sensitivity * linear, 0.0, self._input_um)[rows]
            for sensitivity in sensitivity_systems(model.creep, model.dynamics)
        ]
        for surface in _surfaces(model):
            part = _times(replace(model.hysteresis, offset_um=0.0), surface)
            output_um, _ = self._hysteresis(part, self._amplified_v)
            columns.append(self._respond(linear, 0.0, output_um)[rows])
        more_reversible, _ = self._hysteresis(_traded(model.hysteresis, 1.0), self._amplified_v)
        columns.append(self._respond(linear, 0.0, more_reversible - self._hysteresis_um)[rows])
        return np.column_stack(columns) @ _tuning_map(model)


def _tuning_map(model):
    """Logarithms of the factors of the parameters, for a change of each by one width."""
    pairs = len(model.creep.poles_rad_per_s)
    dynamics = model.dynamics
    others = (
        (dynamics.time_constant_s > 0.0) + 2 * len(dynamics.mode_frequencies_rad_per_s)
        + 2 * len(dynamics.antiresonance_frequencies_rad_per_s) + len(_surfaces(model)) + 1
    )
    tuning = TUNING_WIDTH * np.eye(2 * pairs + others)
    tuning[-1, -1] = REVERSIBLE_WIDTH
    tuning[: 2 * pairs, : 2 * pairs] = CREEP_WIDTH * creep_error_map(model.creep)
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
