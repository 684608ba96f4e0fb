# SPDX-License-Identifier: BSD-3-Clause
"""Estimate how accurate a model of a stage can become, and what a probe cannot measure."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from piezo_identification.experiments.probing.findings import Findings
from piezo_identification.experiments.stage_limits import StageLimits

FEWEST_SAMPLES_PER_CYCLE = 4.0
"""A vibration with fewer samples per cycle may be an alias of one above half the sample rate."""

FEWEST_SETTLING_SAMPLES = 8.0
"""A motion that ends within fewer samples cannot be decomposed into modes and lags."""

NOTABLE_PERCENT = 0.05
"""Error caused by noise above which a remark is made: some times that with a quiet sensor."""


@dataclass(frozen=True)
class Expectation:
    """Model errors that noise causes, in percent of the motion of each experiment.

    Parameters
    ----------
    creep_percent, dynamics_percent, hysteresis_percent : float
        Standard deviations of the means from which each component is identified.
    remarks : tuple of str
        What the experiments cannot identify, and what would help.
    """

    creep_percent: float
    dynamics_percent: float
    hysteresis_percent: float
    remarks: tuple[str, ...] = ()

    @property
    def model_percent(self) -> float:
        """Return the error of the whole model; the errors of the components are independent."""
        return float(np.sqrt(
            self.creep_percent**2 + self.dynamics_percent**2 + self.hysteresis_percent**2))


def expectation(findings: Findings, limits: StageLimits,
                parameters: Mapping[str, Mapping[str, Any]]) -> Expectation:
    """Estimate the model errors that noise causes, and what cannot be identified.

    Parameters
    ----------
    limits : StageLimits
        Limits from `fitted_limits`.
    parameters : dict of str to dict
        Parameters from `fitted_parameters`.
    """
    rate_hz, gain_um_per_v = limits.sample_rate_hz, abs(findings.gain_um_per_v)
    creep, dynamics, hysteresis = (
        parameters[name] for name in ("creep", "dynamics", "hysteresis"))

    def left_percent(travel_v: float, samples: float) -> float:
        noise_um = findings.rest.of_mean_um(max(1, round(samples)))
        return float(100.0 * noise_um / (travel_v * gain_um_per_v))

    # The fastest creep appears after both steps, from one to about ten settling times.
    creep_percent = left_percent(
        creep["swing_v"], 10.0 * findings.response.settling_s * rate_hz)
    dynamics_percent = left_percent(
        dynamics["swing_v"], dynamics["duration_s"] / dynamics["period_s"])
    hysteresis_percent = left_percent(
        limits.span_v, hysteresis["harmonic_period_s"] * rate_hz / (2 * hysteresis["level_count"]))
    found = Expectation(creep_percent, dynamics_percent, hysteresis_percent)
    return Expectation(creep_percent, dynamics_percent, hysteresis_percent, tuple(
        _remarks(findings, limits, found, _duration_s(parameters))))


def _duration_s(parameters: Mapping[str, Mapping[str, Any]]) -> float:
    hysteresis = parameters["hysteresis"]
    return float(
        parameters["creep"]["period_s"] + parameters["dynamics"]["duration_s"]
        + hysteresis["level_count"] * hysteresis["harmonic_period_s"])


def _remarks(findings: Findings, limits: StageLimits, found: Expectation,
             duration_s: float) -> list[str]:
    rate_hz, response, remarks = limits.sample_rate_hz, findings.response, []
    fast = [mode[0] for mode in response.modes
            if mode[0] * FEWEST_SAMPLES_PER_CYCLE > rate_hz]
    if fast:
        remarks.append(
            f"the vibration at {max(fast):.4g} Hz has fewer than {FEWEST_SAMPLES_PER_CYCLE:g} "
            f"samples in a cycle, and may be that of one above half the sample rate of "
            f"{rate_hz:g} Hz: the model then holds at the samples only; use a faster clock")
    if response.settling_s * rate_hz < FEWEST_SETTLING_SAMPLES:
        remarks.append(
            f"the stage settles within {FEWEST_SETTLING_SAMPLES:g} samples of {1.0 / rate_hz:.2g} "
            "s: its fast motion cannot be told apart; use a faster clock")
    if found.model_percent > NOTABLE_PERCENT:
        worst = max((found.creep_percent, "creep"), (found.dynamics_percent, "dynamics"),
                    (found.hysteresis_percent, "hysteresis"))[1]
        remarks.append(
            f"the noise of {findings.rest.noise_rms_um:.2g} um leaves about "
            f"{found.model_percent:.2g} % in the model after {duration_s / 60.0:.3g} min of "
            f"experiments, most of it in the {worst}: only four times that time would halve it; "
            "use a quieter sensor")
    if findings.creep.time_s and not findings.creep.ended:
        remarks.append(
            f"the creep goes on after {findings.creep.time_s:.4g} s: what comes later is not in "
            "the model")
    return remarks
