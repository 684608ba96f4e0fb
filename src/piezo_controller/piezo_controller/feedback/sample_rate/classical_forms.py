# SPDX-License-Identifier: BSD-3-Clause
"""Feedbacks of classical form for a stage with a light mode, each with a few parameters.

The parameters are ratios of frequencies to that of the light mode, and of gains to that of the
stage, so the same bounds hold for any stage. Controllers are discretised by Tustin's rule.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import control
import numpy as np

from piezo_common.arrays import FloatArray
from piezo_controller.feedback.sample_rate.perturbed_loops import light_mode
from piezo_controller.feedback.synthesis.generalised_plant import nominal_hysteresis_gain
from piezo_models.cascade import StageModel

LEAK = 1e-4
"""Pole of a second integration, so that the controller has a single pole on the unit circle."""


@dataclass(frozen=True)
class Form:
    """A form of feedback."""

    title: str

    names: tuple[str, ...]
    """Names of its parameters."""
    bounds: tuple[tuple[float, float], ...]
    """Bounds of the search for each parameter; all positive."""
    start: tuple[float, ...]
    """Initial parameters of the search."""
    make: Callable[[StageModel, FloatArray], control.StateSpace]
    """Takes the model, normalised to nominal gain 1, and the parameters; returns the continuous
    controller."""

    def controller(self, model: StageModel, numbers: Sequence[float] | FloatArray,
                   clock_period_s: float) -> control.StateSpace:
        """Return the discrete controller from error (um) to voltage (V)."""
        gain_um_per_v = nominal_hysteresis_gain(model)
        continuous = self.make(model, np.asarray(numbers, dtype=float))
        return (continuous * (1 / gain_um_per_v)).sample(clock_period_s, method="bilinear")


def _section(numerator: Sequence[float], denominator: Sequence[float]) -> control.StateSpace:
    """Return a proper section of first or second order."""
    return control.ss(control.tf(list(numerator), list(denominator)))


def _light_frequency(model: StageModel) -> float:
    return model.dynamics.mode_frequencies_rad_per_s[light_mode(model)]


def _quadratic(frequency_rad_per_s: float, damping: float) -> list[float]:
    return [1 / frequency_rad_per_s**2, 2 * damping / frequency_rad_per_s, 1.0]


def _pi(model: StageModel, numbers: FloatArray) -> control.StateSpace:
    gain, integral = numbers
    return _section([gain, integral * _light_frequency(model)], [1.0, 0.0])


def _pid(model: StageModel, numbers: FloatArray) -> control.StateSpace:
    gain, integral, lead, roll_off = numbers
    mode = _light_frequency(model)
    return (_pi(model, np.array([gain, integral]))
            + _section([lead / mode, 0.0], [1 / (roll_off * mode), 1.0]))


def _notch_and_pi(model: StageModel, numbers: FloatArray) -> control.StateSpace:
    gain, corner, zero_damping, pole_damping, roll_off = numbers
    mode = _light_frequency(model)
    return (_pi(model, np.array([gain, gain * corner]))
            * _section(_quadratic(mode, zero_damping), _quadratic(mode, pole_damping))
            * _section([1.0], _quadratic(roll_off * mode, 0.7)))


def _integral_resonant(model: StageModel, numbers: FloatArray) -> control.StateSpace:
    """Damp by integral feedback with a feed-through, and integrate around it.

    The damping loop is ``-k / (s + p)``. The tracking loop in series with it is ``-k_i / s``
    (Fleming, Aphale and Moheimani 2010). Together they are ``k (k_i - s) / (s (s + p))``.
    """
    mode = _light_frequency(model)
    gain, integral, pole = numbers
    k = gain * pole * mode
    return (_section([-1.0, integral * mode], [1.0, 0.0])
            * _section([k], [1.0, pole * mode]))


def _force_like(model: StageModel, numbers: FloatArray) -> control.StateSpace:
    """Damp by an estimate of the piezo's force, and integrate around it.

    The force is proportional to the free expansion ``g u`` less the displacement y. The damping
    loop is integral force feedback (Fleming 2010) of ``g u - y``, with a leaky integrator
    ``-d / (s + l)``, so that the tracking loop ``-k_i / s`` remains effective at rest. Together
    they are ``((k_i - d) s + k_i l) / (s (s + l + d))``, as in integral resonant control.
    """
    damping, integral, leak = _light_frequency(model) * numbers
    return _section([integral - damping, integral * leak], [1.0, 0.0]) * _section(
        [1.0], [1.0, leak + damping])


def _positive_position(model: StageModel, numbers: FloatArray) -> control.StateSpace:
    """Damp by positive feedback through a resonance, with a PI around it."""
    mode = _light_frequency(model)
    damping_gain, resonance, filter_damping, gain, corner, roll_off = numbers
    return (_pi(model, np.array([gain, gain * corner]))
            * _section([1.0], _quadratic(roll_off * mode, 0.7))
            - _section([damping_gain], _quadratic(resonance * mode, filter_damping)))


def _inverse_and_pi(model: StageModel, numbers: FloatArray) -> control.StateSpace:
    """Invert the modes with independent dampings, in series with PI and an integration.

    An independent zero replaces the inverse of the lag.
    """
    (crossover, corner, lead, light, light_damping, other_damping, roll_off,
     roll_damping) = numbers
    mode = _light_frequency(model)
    rolling = _quadratic(roll_off * mode, roll_damping)
    controller = (_section([1.0, corner * mode], [1.0, 0.0])
                  * _section([crossover / lead, crossover * mode], [1.0, LEAK * mode])
                  * _section(_quadratic(light * mode, light_damping), rolling)
                  * _section([1.0], [1 / (roll_off * mode), 1.0]))
    dynamics = model.dynamics
    for index, (frequency, damping) in enumerate(zip(
            dynamics.mode_frequencies_rad_per_s, dynamics.damping_ratios, strict=True)):
        if index != light_mode(model):
            controller = controller * _section(
                _quadratic(frequency, other_damping * damping), rolling)
    return controller


FORMS = {
    "pi": Form("PI", ("gain", "integral"), ((1e-4, 3.0), (1e-4, 3.0)), (0.3, 0.15), _pi),
    "pid": Form(
        "PID", ("gain", "integral", "lead", "roll_off"),
        ((1e-4, 3.0), (1e-4, 3.0), (1e-3, 10.0), (0.4, 10.0)), (0.3, 0.15, 0.1, 5.0), _pid),
    "notch_pi": Form(
        "notch + PI",
        ("gain", "corner", "zero_damping", "pole_damping", "roll_off"),
        ((0.003, 3.0), (0.03, 4.0), (0.02, 1.0), (0.2, 3.0), (0.4, 10.0)),
        (0.1, 0.5, 0.1, 1.0, 5.0), _notch_and_pi),
    "integral_resonant": Form(
        "integral resonant control",
        ("gain", "integral", "pole"),
        ((0.01, 5.0), (0.006, 2.5), (0.006, 6.0)), (0.3, 0.2, 0.1),
        _integral_resonant),
    "force_like": Form(
        "force-like feedback", ("damping", "integral", "leak"),
        ((0.006, 6.0), (0.006, 2.5), (0.006, 6.0)), (0.1, 0.2, 0.1), _force_like),
    "positive_position": Form(
        "positive position feedback + PI",
        ("damping_gain", "resonance", "filter_damping", "gain", "corner", "roll_off"),
        ((0.01, 3.0), (0.25, 2.5), (0.05, 2.0), (0.003, 3.0), (0.03, 4.0), (0.4, 10.0)),
        (0.2, 1.0, 0.5, 0.1, 0.5, 5.0), _positive_position),
    "inverse_pi": Form(
        "inverted dynamics + PI",
        ("crossover", "corner", "lead", "light", "light_damping", "other_damping",
         "roll_off", "roll_damping"),
        ((0.13, 2.0), (0.012, 0.25), (0.25, 5.0), (0.6, 1.5), (0.05, 1.0), (0.3, 2.0),
         (1.3, 10.0), (0.15, 1.0)),
        (0.88, 0.21, 0.75, 0.98, 0.07, 0.74, 3.3, 0.21), _inverse_and_pi),
}
"""All forms, by the name of the method in a report."""
