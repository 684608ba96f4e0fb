# SPDX-License-Identifier: BSD-3-Clause
"""The H-infinity problem at the sample rate, with uncertain gain and uncertain light mode.

A disturbance enters before the plant and noise behind it (the four blocks ``S G``, ``S``, ``T``,
``K S``), so that the controller damps the light mode instead of cancelling it.
"""

from dataclasses import dataclass

import control
import numpy as np

from piezo_controller.feedback.sample_rate.perturbed_loops import light_mode
from piezo_models.cascade import StageModel
from piezo_models.linear.dynamics import ElectricVibrationDynamics, zoh

UNCERTAINTIES = 2
"""Scalar uncertainties, which are the first inputs and outputs: the gain, the light mode."""

LEAK_HZ = 0.5
"""Poles of the performance weight (Hz); with integrations there would be no finite norm."""

STEEPNESS = 20.0
"""Ratio of the pole of the control weight to its zero."""


@dataclass(frozen=True)
class SampleRateWeights:
    """Weights of the design, and its uncertainties."""

    crossover_hz: float
    """Frequency below which the error of a disturbance is weighted by ``crossover / f``."""
    corner_hz: float
    """Frequency below which the weight rises with the square of that."""
    peak: float
    """Sensitivity that the weight allows at high frequencies."""
    control_gain: float
    """Allowed voltage, relative to the disturbance's voltage at the input of the stage."""
    roll_off_hz: float
    """Frequency above which less is allowed."""
    noise: float
    """Magnitude of the noise relative to the disturbance."""
    gain_uncertainty: float
    """The gain of the hysteresis lies within ``1 +- gain_uncertainty`` of its nominal value."""
    mode_uncertainty: float
    """The square of the light mode's frequency lies within ``1 +- mode_uncertainty`` of its nominal
    value."""


def light_mode_problem(model: StageModel, weights: SampleRateWeights,
                       clock_period_s: float, delay_ticks: int = 1) -> control.StateSpace:
    """Return the generalised plant of the design, for a plant of gain 1.

    Its inputs are the outputs of the two uncertainties, disturbance, noise and control; its outputs
    the inputs of the two uncertainties, weighted error, weighted control and measured error. Creep
    is omitted: it is slower than all that the feedback is designed for, and its poles close to 1
    would cost the Riccati equations their accuracy. The light mode has no antiresonance; for the
    ticks of computing time see `design_plant`.
    """
    dt = clock_period_s
    samples = 1 + delay_ticks
    delay = control.ss(np.eye(samples, k=-1), np.eye(samples, 1), np.eye(1, samples, k=delay_ticks),
                       [[0.0]], dt)
    plant = _with_uncertain_mode(model, weights.mode_uncertainty, dt) * control.append(
        delay, control.ss([], [], [], [[1.0]], dt))

    def named(system: control.StateSpace, name: str, sources: list[str],
              sinks: list[str]) -> control.StateSpace:
        return control.ss(system.A, system.B, system.C, system.D, dt, name=name,
                          inputs=sources, outputs=sinks)

    def gain(value: float, name: str, source: str, sink: str) -> control.StateSpace:
        return control.ss([], [], [], [[value]], dt, name=name, inputs=[source], outputs=[sink])

    return control.interconnect(
        [
            gain(weights.gain_uncertainty, "uncertain_gain", "u", "gain_in"),
            control.summing_junction(["u", "gain_out", "d"], "u_total", name="input", dt=dt),
            named(plant, "plant", ["u_total", "mode_out"], ["y", "mode_in"]),
            gain(weights.noise, "noise", "n", "sensor_noise"),
            control.summing_junction(["-y", "-sensor_noise"], "m", name="measurement", dt=dt),
            named(_performance(weights, dt), "performance", ["m"], ["weighted_error"]),
            named(_control(weights, dt), "control", ["u"], ["weighted_control"]),
        ],
        inputs=["gain_out", "mode_out", "d", "n", "u"],
        outputs=["gain_in", "mode_in", "weighted_error", "weighted_control", "m"])


def _with_uncertain_mode(model: StageModel, uncertainty: float,
                         dt: float) -> control.StateSpace:
    """Return the sampled dynamics with a second input and output for the light mode's uncertainty.

    With ``mode_out = delta mode_in`` the square of its frequency is multiplied by
    ``1 + uncertainty * delta``. Its static gain changes with it, and counts as uncertain gain.
    """
    dynamics, light = model.dynamics, light_mode(model)
    others = [index for index in range(len(dynamics.damping_ratios)) if index != light]
    first = ElectricVibrationDynamics(
        dynamics.time_constant_s,
        tuple(dynamics.mode_frequencies_rad_per_s[index] for index in others),
        tuple(dynamics.damping_ratios[index] for index in others)).state_space()
    frequency = dynamics.mode_frequencies_rad_per_s[light]
    mode = control.ss(
        [[0.0, frequency], [-frequency, -2 * dynamics.damping_ratios[light] * frequency]],
        [[0.0, 0.0], [frequency, -frequency * uncertainty]], [[1.0, 0.0], [1.0, 0.0]],
        np.zeros((2, 2)))
    return zoh(mode * control.append(first, control.ss([], [], [], [[1.0]])), dt)


def _performance(weights: SampleRateWeights, dt: float) -> control.StateSpace:
    leak, corner, crossover = (
        2 * np.pi * value for value in (LEAK_HZ, weights.corner_hz, weights.crossover_hz))
    error = control.ss(control.tf([1 / weights.peak, crossover], [1.0, leak]))
    return (error * control.ss(control.tf([1.0, corner], [1.0, leak]))).sample(dt, "bilinear")


def _control(weights: SampleRateWeights, dt: float) -> control.StateSpace:
    corner = 2 * np.pi * weights.roll_off_hz
    lead = control.tf([1 / corner, 1.0], [1 / (STEEPNESS * corner), 1.0])
    return control.ss(lead / weights.control_gain).sample(dt, "bilinear")
