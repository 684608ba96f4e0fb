# SPDX-License-Identifier: BSD-3-Clause
"""Design of the discrete H-infinity feedback at the tick's rate (thesis 5.2.4)."""

from dataclasses import dataclass

import control
import numpy as np

from piezo_controller.h_infinity import close, synthesise
from piezo_controller.lifted_plant import lift
from piezo_controller.loop_measures import measure_loop
from piezo_models.linear import zoh

# Lowers the controller's resonance at 270 Hz from 7 to 3 V/um, and the sensitivity's peak.
SLACK = 0.1


@dataclass(frozen=True)
class FeedbackController:
    """State space of the feedback, and what is known of the loop it closes.

    Attributes
    ----------
    A, B, C, D : ndarray
        From the mean tracking error of the last tick (um) to the voltage of the next (V).
    sample_period_s : float
        The tick (s).
    report : dict
        Plain numbers, see `design_feedback`.
    weights : dict
        The weights that it was designed with, in the layout of the weights file.
    model_sha256 : str
        Of the model file that it was designed for; empty if the model came from no file.
    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    sample_period_s: float
    report: dict
    weights: dict
    model_sha256: str = ""

    def state_space(self):
        """The controller as a ``control.StateSpace``."""
        return control.ss(self.A, self.B, self.C, self.D, self.sample_period_s)


def design_plant(model, tick_s, clock_period_s):
    """The linear plant that the feedback is designed on.

    Parameters
    ----------
    model : piezo_models.cascade.StageModel
    tick_s, clock_period_s : float
        Periods of the feedback and of the sample clock (s); the one a multiple of the other.

    Returns
    -------
    plant : control.StateSpace
        From the hysteresis' output decided in a tick to the mean displacement known in it (um
        per um), with the hold, the averaging and the computing time (`lift`).
    hysteresis_gain_um_per_v : float
        Nominal gain k_h: the middle of the secant gains (3.16) at mid-travel.
    """
    samples_per_tick = round(tick_s / clock_period_s)
    if samples_per_tick < 1 or abs(samples_per_tick * clock_period_s / tick_s - 1) > 1e-9:
        raise ValueError(f"the tick of {tick_s:g} s is no multiple of the sample clock's period "
                         f"of {clock_period_s:g} s")
    plant = lift(zoh(model.linear(), clock_period_s), samples_per_tick)
    hysteresis = model.hysteresis
    middle_v = (hysteresis.voltage_min_v + hysteresis.voltage_max_v) / 2
    return plant, float(np.mean(hysteresis.gain_um_per_v([middle_v])))


def generalised_plant(plant, hysteresis_gain_um_per_v, weights):
    """The design problem of thesis fig. 5.5.

    The feedforward's error enters from the reference alone, outside the loop: it is a
    disturbance of size ``w_delta w_r``.

    Parameters
    ----------
    plant, hysteresis_gain_um_per_v
        From `design_plant`.
    weights : DesignWeights

    Returns
    -------
    control.StateSpace
        Inputs: hysteresis uncertainty, reference, disturbance, noise, control. Outputs: input of
        the uncertainty, weighted error, weighted control, measured error.
    """
    dt = plant.dt

    def named(system, name, source, sink):
        return control.ss(system.A, system.B, system.C, system.D, dt, name=name,
                          inputs=[source], outputs=[sink])

    def gain(value, name, source, sink):
        return control.ss([], [], [], [[value]], dt, name=name, inputs=[source], outputs=[sink])

    def weight(name, source, sink, scale=1.0):
        return named(scale * getattr(weights, name).state_space(dt), name, source, sink)

    k_h = hysteresis_gain_um_per_v
    return control.interconnect(
        [
            gain(weights.hysteresis_uncertainty, "uncertain", "u", "z_u"),
            control.summing_junction(["u", "d_u"], "u_total", name="input", dt=dt),
            named(k_h * plant, "plant", "u_total", "y"),
            weight("reference", "r", "feedforward_error", weights.feedforward_error),
            weight("disturbance", "d", "offset"),
            control.summing_junction(["-feedforward_error", "-offset", "-y"], "e", name="error",
                                     dt=dt),
            weight("performance", "e", "z_e"),
            weight("control", "u", "z_c"),
            weight("noise", "n", "sensor_noise"),
            control.summing_junction(["e", "-sensor_noise"], "m", name="measurement", dt=dt),
        ],
        inputs=["d_u", "r", "d", "n", "u"], outputs=["z_u", "z_e", "z_c", "m"])


def design_feedback(model, weights, clock_period_s=25e-6, model_sha256=""):
    """Design the feedback for a model of the stage.

    Parameters
    ----------
    model : piezo_models.cascade.StageModel
    weights : DesignWeights
    clock_period_s : float
        Period of the sample clock (s).
    model_sha256 : str
        Hash of the model's file, kept with the controller.

    Returns
    -------
    FeedbackController
        Its report holds ``gamma``, ``closed_loop_norm``, ``order``, ``hysteresis_gain_um_per_v``
        and the measures of `measure_loop`.

    Raises
    ------
    NoController
        The weights ask for too much.
    """
    plant, gain_um_per_v = design_plant(model, weights.sample_period_s, clock_period_s)
    problem = generalised_plant(plant, gain_um_per_v, weights)
    controller, gamma = synthesise(problem, SLACK)
    report = {
        "gamma": float(gamma),
        "closed_loop_norm": float(control.linfnorm(close(problem, controller))[0]),
        "order": controller.nstates,
        "hysteresis_gain_um_per_v": gain_um_per_v,
        **measure_loop(gain_um_per_v * plant, controller, weights.hysteresis_uncertainty),
    }
    return FeedbackController(controller.A, controller.B, controller.C, controller.D,
                              weights.sample_period_s, report, weights.as_dict(), model_sha256)
