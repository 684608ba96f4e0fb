# SPDX-License-Identifier: BSD-3-Clause
"""The file of a probe: its results, and the experiments that suit the stage."""

import dataclasses
from pathlib import Path
from typing import Any, ClassVar

from piezo_common.schema import (
    Document,
    NotNegative,
    Number,
    Numbers,
    Part,
    Positive,
    SchemaError,
    entry,
    load_document,
)
from piezo_common.text_file import replace_document
from piezo_identification.experiments.probing.findings import Findings
from piezo_identification.experiments.probing.fitted import (
    ExpectedErrors,
    expected_errors,
    fitted_limits,
    fitted_parameters,
)
from piezo_identification.experiments.stage_limits import StageLimits

NAME = "probe.json"
"""Name of the file in a directory; it sets the parameters of the experiments recorded there."""

FORMAT, VERSION = "piezo_probe", 1

OF_THE_LIMITS = (
    "voltage_min_v", "voltage_max_v", "rest_voltage_v", "slew_limit_v_per_s", "sample_rate_hz")


class ProbeFileError(ValueError):
    """The file of a probe cannot be used; the message gives the path and a remedy."""


class ProbedMode(Part):
    """A visible vibration."""

    frequency_hz: Positive = entry("Natural frequency.", unit="Hz")
    damping_ratio: Positive = entry("Damping ratio.", unit="1")
    step_share: Positive = entry("Amplitude after a step over the step.", unit="1")


class ProbedStage(Part):
    """Measured properties of the stage."""

    step_v: Number = entry("Largest step that was played, from rest.", unit="V")
    signal_to_noise: Positive = entry(
        "Of that step over the RMS noise of a sample.", unit="1")
    rest_level_um: Number = entry("Displacement at rest.", unit="um")
    noise_rms_um: Positive = entry("Noise of a sample.", unit="um")
    gain_um_per_v: Number = entry("Gain of the first rise to that step, signed.", unit="um/V")
    lag_s: NotNegative = entry(
        "Time constant of the largest motion without ringing; 0: none was found.", unit="s")
    settling_s: Positive = entry("Time until 1 % of a step remains, without creep.", unit="s")
    modes: list[ProbedMode] = entry("Vibrations, the largest first.")
    creep_share_per_decade: Number = entry("Creep over the step in a decade of time.", unit="1")
    creep_time_s: NotNegative = entry("Up to which the stage creeps; 0: no creep.", unit="s")
    creep_ended: bool = entry("Whether the creep faded.")


class ProbedLimits(Part):
    """Limits of the stage."""

    voltage_min_v: Number = entry("Lowest voltage.", unit="V")
    voltage_max_v: Number = entry("Highest voltage.", unit="V")
    rest_voltage_v: Number = entry("Voltage at rest.", unit="V")
    slew_limit_v_per_s: Positive = entry("Largest rate of the voltage.", unit="V/s")
    sample_rate_hz: Positive = entry("Sample clock.", unit="Hz")


class ProbedRange(Part):
    """Voltages that the experiments use."""

    voltage_min_v: Number = entry("Lowest voltage.", unit="V")
    voltage_max_v: Number = entry("Highest voltage.", unit="V")


class CreepParameters(Part):
    """Parameters of the experiment `creep`."""

    swing_v: Positive = entry("Difference of the two levels.", unit="V")
    period_s: Positive = entry("Period of the square wave.", unit="s")
    sample_period_s: Positive = entry("Time for which each value is held.", unit="s")


class DynamicsParameters(Part):
    """Parameters of the experiment `dynamics`."""

    swing_v: Positive = entry("Difference of the two levels.", unit="V")
    period_s: Positive = entry("Period of the square wave.", unit="s")
    duration_s: Positive = entry("Length of the whole.", unit="s")


class HysteresisParameters(Part):
    """Parameters of the experiment `hysteresis`."""

    level_count: int = entry("Number of harmonics.", at_least=2)
    harmonic_period_s: Positive = entry("Period of each.", unit="s")
    sample_period_s: Positive = entry("Time for which each value is held.", unit="s")


class TonesParameters(Part):
    """Parameters of the experiments `validation` and `multisine`."""

    arc_s: Positive = entry("Time from one turning point to the next.", unit="s")
    tones_s: Positive = entry("Length of the part with tones.", unit="s")
    tones: list[Numbers] = entry("Frequency (Hz) and amplitude over the voltage range of each.")


class RelayParameters(Part):
    """Parameters of the experiment `relay`."""

    oscillation_s: Positive = entry("For which the relay acts.", unit="s")


class FittedExperiments(Part):
    """Parameters of the experiments, by their names."""

    creep: CreepParameters = entry("Long square wave.")
    dynamics: DynamicsParameters = entry("Short square wave.")
    hysteresis: HysteresisParameters = entry("Harmonics of rising amplitude.")
    validation: TonesParameters = entry("Arcs and tones that are not fitted.")
    multisine: TonesParameters = entry("Tones about mid-range.")
    relay: RelayParameters = entry("Relay feedback.")


class ProbeDocument(Document):
    """The file of a probe."""

    TITLE: ClassVar[str] = "file of a probe"
    FORMAT: ClassVar[str] = FORMAT
    VERSION: ClassVar[int] = VERSION
    RENEW: ClassVar[str] = "probe again"

    format: str = entry(f"Always {FORMAT}.")
    version: Number = entry(f"Always {VERSION}.")
    limits: ProbedLimits = entry("What the stage allowed; the file is for such a stage only.")
    stage: ProbedStage = entry("What was found.")
    range: ProbedRange = entry(
        "Voltages that the experiments use; narrower than allowed where the sensor's range is.")
    experiments: FittedExperiments = entry("Parameters of the experiments.")
    expected: ExpectedErrors | None = entry(
        "What to expect of a model; null where an older suite wrote the file.", default=None)

    def fitted(self, name: str) -> dict[str, Any]:
        """Return the parameters of an experiment; empty if the probe sets none."""
        part = getattr(self.experiments, name, None)
        return part.model_dump() if isinstance(part, Part) else {}

    def usable(self, limits: StageLimits) -> StageLimits:
        """Return the limits within which the experiments stay on a stage.

        Raises
        ------
        ProbeFileError
            If the file belongs to a stage with other limits.
        """
        for name in OF_THE_LIMITS:
            probed, present = getattr(self.limits, name), getattr(limits, name)
            if probed != present:
                raise ProbeFileError(f"the probe was made with {name} {probed:g}, the stage has "
                                     f"{present:g}: probe again, or use another directory")
        return dataclasses.replace(limits, **self.range.model_dump())


def probe_document(findings: Findings, limits: StageLimits) -> ProbeDocument:
    """Choose the experiments from the results, and return both.

    Raises
    ------
    ValueError
        If the sensor's range leaves no room for the experiments.
    """
    usable, response = fitted_limits(findings, limits), findings.response
    parameters = fitted_parameters(findings, usable)
    return ProbeDocument.model_validate({
        "format": FORMAT, "version": float(VERSION),
        "limits": {name: float(getattr(limits, name)) for name in OF_THE_LIMITS},
        "stage": {
            "step_v": float(findings.step_v),
            "signal_to_noise": float(findings.signal_to_noise),
            "rest_level_um": findings.rest.level_um, "noise_rms_um": findings.rest.noise_rms_um,
            "gain_um_per_v": float(findings.gain_um_per_v),
            "lag_s": response.lag_s, "settling_s": response.settling_s,
            "modes": [{"frequency_hz": float(frequency_hz), "damping_ratio": float(damping),
                       "step_share": float(share)}
                      for frequency_hz, damping, share in response.modes],
            "creep_share_per_decade": findings.creep.share_per_decade,
            "creep_time_s": findings.creep.time_s, "creep_ended": bool(findings.creep.ended)},
        "range": {"voltage_min_v": float(usable.voltage_min_v),
                  "voltage_max_v": float(usable.voltage_max_v)},
        "experiments": parameters,
        "expected": expected_errors(findings, usable, parameters).model_dump()})


def save_probe(path: str | Path, document: ProbeDocument) -> None:
    """Write the file in one step, and replace an existing one.

    Raises
    ------
    ProbeFileError
        If it cannot be written.
    """
    replace_document(path, document.model_dump(), "file of a probe", ProbeFileError)


def load_probe(path: str | Path) -> ProbeDocument:
    """Read the file of a probe.

    Raises
    ------
    ProbeFileError
        If it cannot be read or does not fit its schema.
    """
    try:
        return load_document(ProbeDocument, path)
    except SchemaError as error:
        raise ProbeFileError(f"{path}: {error}") from None


def probe_summary(document: ProbeDocument) -> str:
    """Return the results and the chosen experiments as text, one line each."""
    stage, experiments = document.stage, document.experiments
    modes = ", ".join(f"{mode.frequency_hz:.4g} Hz (damping {mode.damping_ratio:.2g})"
                      for mode in stage.modes) or "none seen"
    creep = (f"{100.0 * stage.creep_share_per_decade:.2g} % per decade up to "
             f"{stage.creep_time_s:g} s{'' if stage.creep_ended else ' and longer'}"
             if stage.creep_time_s else "none seen")
    used, allowed = document.range, document.limits
    narrowed = (used.voltage_min_v, used.voltage_max_v) != (
        allowed.voltage_min_v, allowed.voltage_max_v)
    return "\n".join([
        f"gain {stage.gain_um_per_v:.3g} um/V at {stage.step_v:.3g} V, noise "
        f"{stage.noise_rms_um:.2g} um RMS",
        f"settles within {stage.settling_s:.2g} s; vibrations: {modes}",
        f"creep: {creep}",
        f"experiments use {used.voltage_min_v:.4g}..{used.voltage_max_v:.4g} V"
        + (", as the sensor's range allows no more" if narrowed else ""),
        f"periods: creep {experiments.creep.period_s:g} s, dynamics "
        f"{experiments.dynamics.period_s:g} s, harmonics "
        f"{experiments.hysteresis.harmonic_period_s:g} s",
        *([f"noise causes about {document.expected.model_percent:.2g} % error of the model",
           *document.expected.remarks] if document.expected else [])])
