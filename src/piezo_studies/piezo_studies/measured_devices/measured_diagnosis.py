# SPDX-License-Identifier: BSD-3-Clause
"""Diagnose deliberately poor models of measured stages, and test the extended models."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from piezo_identification.diagnosis.diagnose import diagnose
from piezo_identification.diagnosis.response.response_diagnosis import diagnose_response
from piezo_identification.estimators.frequency_response.response_file import read_frequency_response
from piezo_identification.estimators.frequency_response.response_fit import (
    ResponseOrder,
    estimate_from_response,
)
from piezo_identification.estimators.hysteresis.density_fit import estimate_density
from piezo_identification.prediction import predict
from piezo_models.cascade import StageModel
from piezo_models.effects.delay import Delay
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_recorder.reading.reader import read_recording
from piezo_studies.measured_devices.measured import (
    BAND_HZ,
    CANTILEVER,
    MAJOR_LOOPS,
    NANOPOSITIONER,
    NESTED_LOOPS,
    RINGING_S,
    SMOOTHING_WEIGHT,
    TRANSLATION_WEIGHT,
    first_cycle,
    fitted_cycles,
)

BEFORE_JUMP_S = 0.12
"""Time at rest before the jump that is diagnosed with the ringing."""

RESONANCES_HZ = (100.0, 1000.0)
RESONANCES = ResponseOrder(creep_pairs=0, modes=None, antiresonances=None)


@dataclass(frozen=True)
class Finding:
    """The result of a diagnosis, with the errors before and after on held-out data."""

    data: str
    poor_model: str
    verdict: str

    effects: tuple
    """Named effects, the strongest first."""
    held_out: str

    before_percent: float
    after_percent: float
    """Relative error e_y of the poor model, and of the extended model."""
    refitted_percent: float | None = None
    """Relative error e_y of a model fitted without the restriction of the poor one."""
    left: str = ""

    def text(self):
        """Return a description of the result."""
        refitted = "" if self.refitted_percent is None else (
            f", {self.refitted_percent:.3g} % by a fit without that restriction")
        if self.refitted_percent is not None and self.refitted_percent < self.after_percent:
            refitted += ": rather the restriction than the effects"
        return (
            f"{self.data}, {self.poor_model}: {self.verdict}, "
            f"{', '.join(self.effects) or 'no effect'}; e_y on {self.held_out} "
            f"{self.before_percent:.3g} % before, {self.after_percent:.3g} % after{refitted}. "
            f"{self.left}".strip()
        )


def cantilever_without_vibration(directory):
    """Diagnose a static hysteresis, fitted on slow cycles, on rest and ringing after the jump."""
    recording = read_recording(Path(directory) / CANTILEVER)
    static = _static(fitted_cycles(recording)[0])
    jump, _ = first_cycle(recording.voltage_v)
    before, after = (round(each_s / recording.sample_period_s)
                     for each_s in (BEFORE_JUMP_S, RINGING_S))
    sample = np.arange(recording.voltage_v.size)
    ringing = recording.select((sample >= jump - before) & (sample < jump + after))
    return finding_of("cantilever", "static hysteresis", diagnose(static, [ringing]),
                      "a third of the samples around the jump")


def nanopositioner_without_creep(directory):
    """Diagnose a model of only the resonances on the response from 1 Hz on."""
    measured = read_frequency_response(Path(directory) / NANOPOSITIONER).between(*BAND_HZ)
    fit = estimate_from_response(measured.between(*RESONANCES_HZ), RESONANCES).model
    line = PreisachModel.line(-1.0, 1.0, fit.gain)
    model = StageModel(
        line, CreepDynamics(), fit.dynamics, effects=(*fit.parallel, Delay(fit.delay_s)))
    return finding_of("nanopositioner", "resonances only", diagnose_response(model, measured),
                      "a third of the frequencies")


def scanner_without_asymmetry(directory):
    """Diagnose a symmetric hysteresis on the loops it was fitted on, tested on the others."""
    nested, major = (read_recording(Path(directory) / name) for name in (NESTED_LOOPS, MAJOR_LOOPS))
    for fitted, unseen, names in ((major, nested, ("major", "nested")),
                                  (nested, major, ("nested", "major"))):
        hysteresis = estimate_density(
            fitted, CreepDynamics(), ElectricVibrationDynamics(), level_count=50,
            smoothing_weight=SMOOTHING_WEIGHT, translation_weight=TRANSLATION_WEIGHT,
        ).model()
        diagnosis = diagnose(_static(symmetric(hysteresis)), [fitted], unseen)
        finding = finding_of(f"scanner, {names[0]} loops", "symmetric hysteresis", diagnosis,
                             f"{names[1]} loops")
        yield replace(
            finding, refitted_percent=predict(_static(hysteresis), unseen).e_y_percent())


def symmetric(hysteresis):
    """Return the nearest hysteresis whose falling branches are rising ones turned by 180 degrees.

    Its density is unchanged if both thresholds are mirrored at the middle.
    """
    density, reversible = hysteresis.density_um_per_v2, hysteresis.reversible_um_per_v
    return replace(
        hysteresis, density_um_per_v2=0.5 * (density + density[::-1, ::-1].T),
        reversible_um_per_v=0.5 * (reversible + reversible[::-1]),
    )


def _static(hysteresis):
    return StageModel(hysteresis, CreepDynamics(), ElectricVibrationDynamics())


def finding_of(data, poor_model, diagnosis, held_out):
    """Return what a diagnosis finds wanting of a poor model of some data."""
    return Finding(
        data, poor_model, diagnosis.verdict,
        tuple(entry["name"] for entry in diagnosis.effects), held_out,
        diagnosis.before["e_y_percent"], diagnosis.after["e_y_percent"], left=diagnosis.left,
    )
