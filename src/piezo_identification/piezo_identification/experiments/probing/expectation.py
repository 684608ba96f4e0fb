# SPDX-License-Identifier: BSD-3-Clause
"""Estimate how accurate a model of a stage can become, and what a probe cannot measure."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from piezo_common.schema import NotNegative, Part, entry
from piezo_identification.experiments.probing.findings import Findings
from piezo_identification.experiments.stage_limits import StageLimits

FEWEST_SAMPLES_PER_CYCLE = 4.0
"""A vibration with fewer samples per cycle may be an alias of one above half the sample rate."""

FEWEST_SETTLING_SAMPLES = 8.0
"""A motion that ends within fewer samples cannot be decomposed into modes and lags."""

NOTABLE_PERCENT = 0.05
"""Error caused by noise above which a remark is made: some times that with a quiet sensor."""


class ExpectedErrors(Part):
    """Errors that noise causes in a model identified from these experiments."""

    creep_percent: NotNegative = entry("Of the creep.", unit="%")
    dynamics_percent: NotNegative = entry("Of the dynamics.", unit="%")
    hysteresis_percent: NotNegative = entry("Of the hysteresis.", unit="%")
    model_percent: NotNegative = entry("Of the whole model.", unit="%")
    remarks: list[str] = entry("What is out of reach on this stage, and what would help.")


def expected_errors(findings: Findings, limits: StageLimits,
                    parameters: Mapping[str, Mapping[str, Any]]) -> ExpectedErrors:
    """Estimate the model errors that noise causes, and what cannot be identified.

    Errors are standard deviations of the means that decide on each component, in percent of what
    its experiment moves.

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

    def error_percent(travel_v: float, samples: float) -> float:
        noise_um = findings.rest.of_mean_um(max(1, round(samples)))
        return float(100.0 * noise_um / (travel_v * gain_um_per_v))

    # The fastest creep appears after both steps, from one to about ten settling times.
    percent = {
        "creep": error_percent(
            creep["swing_v"], 10.0 * findings.response.settling_s * rate_hz),
        "dynamics": error_percent(
            dynamics["swing_v"], dynamics["duration_s"] / dynamics["period_s"]),
        "hysteresis": error_percent(
            limits.span_v,
            hysteresis["harmonic_period_s"] * rate_hz / (2 * hysteresis["level_count"])),
    }
    # The errors of the components are independent.
    model_percent = float(np.sqrt(sum(each**2 for each in percent.values())))
    return ExpectedErrors.model_validate({
        **{f"{name}_percent": each for name, each in percent.items()},
        "model_percent": model_percent,
        "remarks": _remarks(findings, limits, percent, model_percent, _duration_s(parameters))})


def _duration_s(parameters: Mapping[str, Mapping[str, Any]]) -> float:
    hysteresis = parameters["hysteresis"]
    return float(
        parameters["creep"]["period_s"] + parameters["dynamics"]["duration_s"]
        + hysteresis["level_count"] * hysteresis["harmonic_period_s"])


def _remarks(findings: Findings, limits: StageLimits, percent: Mapping[str, float],
             model_percent: float, duration_s: float) -> list[str]:
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
            "s: its fast motion cannot be resolved; use a faster clock")
    if model_percent > NOTABLE_PERCENT:
        worst = max(percent, key=percent.__getitem__)
        remarks.append(
            f"the noise of {findings.rest.noise_rms_um:.2g} um causes about "
            f"{model_percent:.2g} % error of the model after {duration_s / 60.0:.3g} min of "
            f"experiments, most of it in the {worst}: only four times that time would halve it; "
            "use a quieter sensor")
    if findings.creep.time_s and not findings.creep.ended:
        remarks.append(
            f"the creep goes on after {findings.creep.time_s:.4g} s: what comes later is not in "
            "the model")
    return remarks
