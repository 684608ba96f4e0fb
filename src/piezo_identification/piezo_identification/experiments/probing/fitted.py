# SPDX-License-Identifier: BSD-3-Clause
"""Choose the parameters of the experiments from the results of a probe."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from piezo_common.schema import NotNegative, Part, entry
from piezo_identification.experiments.catalogue import (
    MULTISINE_TONES,
    SWING_FRACTION,
    VALIDATION_TONES,
)
from piezo_identification.experiments.input_designs import HIGHEST_OF_CLOCK
from piezo_identification.experiments.probing.findings import SENSOR_MARGIN, Findings
from piezo_identification.experiments.stage_limits import StageLimits

LARGE_SIGNAL = (2.0, 1.3)
"""Upper bounds of the gain over the whole range relative to that of a step: for the smallest step,
whose loop has hardly more than half the gain, and for one of `SWING_FRACTION` of the range."""

LEAST_RANGE = 0.1
"""Smallest fraction of the voltage range with which a model can be identified."""

HALF_PERIOD_SETTLINGS = 2.0
"""Settling times in half a period of the dynamics, so that each step response is complete."""

PRECISION = 4e-5
"""Wanted noise of the mean step response as a fraction of the step; sets the number of periods."""

PERIODS, LONGEST_DYNAMICS_S = (100, 1000), 30.0
"""Fewest and most periods of the dynamics, and their longest duration."""

LEVEL_COUNT = 70
"""Harmonics of the hysteresis, as in the thesis (4.7.2)."""

HARMONIC_SETTLINGS = 350.0
"""Settling times in a harmonic, so that the dynamics are a small correction to the hysteresis."""

LEVEL_PRECISION = 1e-4
"""Wanted noise of the mean within a level as a fraction of the travel."""

HARMONIC_S = (0.2, 8.0)
"""Shortest and longest period of a harmonic."""

HELD_SETTLINGS, MOST_HELD = 0.17, 10_000
"""Settling times for which a value of a harmonic is held (the mean over a longer time loses the
lag), and most values in a harmonic (which bounds the memory of the estimate)."""

CREEP_TIMES = 1.0
"""Half a period of the creep experiment over the time until which the stage creeps."""

CREEP_PERIOD_S = (20.0, 1600.0)
"""Shortest and longest period of the creep experiment."""

CREEP_SETTLINGS = 2.0
"""Settling times in a sample of the creep, so that the fast motion ends within the first."""

ARC_SETTLINGS, CLIMB_SETTLINGS = 45.0, 90.0
"""Settling times in an arc of the validation, and in the climb before the multisine."""

ARC_S, TONES_S = 0.25, (1.0, 10.0)
"""Shortest arc; shortest and longest duration of the tones."""

ABOVE_THE_MODES = 1.3
"""Highest tone over the highest frequency of the stage."""

LARGEST_PEAK = 1.5
"""Largest gain at a tone over the static gain before the tone is made smaller."""

RELAY_S, RELAY_SETTLINGS = 0.5, 100.0
"""Shortest duration of the relay, and its duration in settling times."""

FEWEST_SAMPLES_PER_CYCLE = 4.0
"""A vibration with fewer samples per cycle may be an alias of one above half the sample rate."""

FEWEST_SETTLING_SAMPLES = 8.0
"""A motion that ends within fewer samples cannot be decomposed into modes and lags."""

NOTABLE_PERCENT = 0.05
"""Error caused by noise above which a remark is made: some times that with a quiet sensor."""


def fitted_limits(findings: Findings, limits: StageLimits) -> StageLimits:
    """Narrow the voltage range so that the displacement stays within the range of the sensor.

    Raise ValueError if the narrowed range is too small to identify a model.
    """
    size = abs(findings.step_v) / limits.span_v
    gain_um_per_v = findings.gain_um_per_v * float(
        np.interp(size, [0.0, SWING_FRACTION], LARGE_SIGNAL))
    margin_um = SENSOR_MARGIN * limits.displacement_span_um
    rooms_v = sorted(
        (end_um - findings.rest.level_um) / gain_um_per_v
        for end_um in (limits.displacement_min_um + margin_um,
                       limits.displacement_max_um - margin_um))
    lowest_v = max(limits.voltage_min_v, limits.rest_voltage_v + min(rooms_v[0], 0.0))
    highest_v = min(limits.voltage_max_v, limits.rest_voltage_v + max(rooms_v[1], 0.0))
    if highest_v - lowest_v < LEAST_RANGE * limits.span_v:
        raise ValueError(
            f"the sensor's range of {limits.displacement_min_um:g}..{limits.displacement_max_um:g} "
            f"um leaves only {lowest_v:.4g}..{highest_v:.4g} V for experiments: correct it, or "
            "the rest voltage")
    return replace(limits, voltage_min_v=lowest_v, voltage_max_v=highest_v)


def fitted_parameters(findings: Findings, limits: StageLimits) -> dict[str, dict[str, Any]]:
    """Choose the arguments of each experiment, by name, with limits from `fitted_limits`."""
    clock_s, settling_s = 1.0 / limits.sample_rate_hz, findings.response.settling_s
    swing_v = min(SWING_FRACTION * limits.span_v, limits.largest_step_v)
    return {
        "creep": _creep(findings, swing_v, clock_s),
        "dynamics": _dynamics(findings, swing_v, clock_s),
        "hysteresis": _hysteresis(findings, limits, clock_s),
        "validation": {
            "arc_s": _rounded(max(ARC_S, ARC_SETTLINGS * settling_s), clock_s),
            **_tones(findings, limits, VALIDATION_TONES)},
        "multisine": {
            "arc_s": _rounded(max(2.0 * ARC_S, CLIMB_SETTLINGS * settling_s), clock_s),
            **_tones(findings, limits, MULTISINE_TONES)},
        "relay": {"oscillation_s": max(RELAY_S, RELAY_SETTLINGS * settling_s)},
    }


def _creep(findings: Findings, swing_v: float, clock_s: float) -> dict[str, Any]:
    period_s = float(np.clip(2.0 * CREEP_TIMES * findings.creep.time_s, *CREEP_PERIOD_S))
    sample_s = _two_digits(CREEP_SETTLINGS * findings.response.settling_s)
    sample_s = _rounded(min(sample_s, period_s / 2000.0, 1.0), clock_s)
    return {"swing_v": swing_v, "period_s": _rounded(period_s, 2.0 * sample_s),
            "sample_period_s": sample_s}


def _dynamics(findings: Findings, swing_v: float, clock_s: float) -> dict[str, Any]:
    half_s = HALF_PERIOD_SETTLINGS * _two_digits(findings.response.settling_s)
    period_s = 2.0 * _rounded(max(half_s, 20.0 * clock_s), clock_s)
    noise = findings.rest.noise_rms_um / abs(swing_v * findings.gain_um_per_v)
    most = max(PERIODS[0], min(PERIODS[1], int(LONGEST_DYNAMICS_S / period_s)))
    periods = int(np.clip(np.ceil((noise / PRECISION) ** 2), PERIODS[0], most))
    return {"swing_v": swing_v, "period_s": period_s, "duration_s": periods * period_s}


def _hysteresis(findings: Findings, limits: StageLimits, clock_s: float) -> dict[str, Any]:
    travel_um = abs(findings.gain_um_per_v) * limits.span_v
    averaged = (findings.rest.noise_rms_um / (LEVEL_PRECISION * travel_um)) ** 2
    wanted_s = max(HARMONIC_SETTLINGS * findings.response.settling_s,
                   2.0 * LEVEL_COUNT * averaged * clock_s)
    sample_s = _rounded(HELD_SETTLINGS * findings.response.settling_s, clock_s)
    held = min(round(float(np.clip(wanted_s, *HARMONIC_S)) / sample_s), MOST_HELD)
    return {"level_count": LEVEL_COUNT, "harmonic_period_s": held * sample_s,
            "sample_period_s": sample_s}


def _tones(findings: Findings, limits: StageLimits,
           usual: Sequence[tuple[float, float]]) -> dict[str, Any]:
    """Scale the usual tones to the frequencies of the stage, and reduce them at resonances."""
    response = findings.response
    highest_hz = max([mode[0] for mode in response.modes] or [3.0 / response.settling_s])
    top_hz = min(ABOVE_THE_MODES * highest_hz, HIGHEST_OF_CLOCK * limits.sample_rate_hz)
    stretch = top_hz / usual[-1][0]
    tones_s = float(np.clip(100.0 / (stretch * usual[0][0]), *TONES_S))
    tones = []
    for usual_hz, usual_share in usual:
        # Whole cycles, so that the tones end where they began.
        frequency_hz = round(usual_hz * stretch * tones_s) / tones_s
        peak = max(response.magnitude(frequency_hz) / LARGEST_PEAK, 1.0)
        tones.append([frequency_hz, usual_share / peak])
    steps_v = limits.span_v * 2.0 * np.pi / limits.sample_rate_hz * sum(
        frequency_hz * share for frequency_hz, share in tones)
    slower = min(1.0, 0.9 * limits.slew_limit_v_per_s / limits.sample_rate_hz / steps_v)
    return {"tones_s": _rounded(tones_s, 1.0 / limits.sample_rate_hz),
            "tones": [[frequency_hz, share * slower] for frequency_hz, share in tones]}


def _rounded(time_s: float, unit_s: float) -> float:
    """Return the nearest whole multiple of a unit, at least one."""
    return max(1, round(time_s / unit_s)) * unit_s


def _two_digits(value: float) -> float:
    return float(f"{value:.1e}")


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
    its experiment moves. Limits and parameters are those of `fitted_limits` and
    `fitted_parameters`.
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
