# SPDX-License-Identifier: BSD-3-Clause
"""Two benchmarks of nonlinear oscillators: linear model, diagnosis, and errors on unseen data.

They are a circuit that behaves like a mass on a cubic spring (Silverbox), and a mass on a spring
with hysteresis (Bouc-Wen).
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from piezo_identification import identify
from piezo_identification.diagnosis.diagnose import diagnose
from piezo_identification.prediction import predict
from piezo_identification.prediction.row_reading import read_as_identified
from piezo_models.cascade import StageModel
from piezo_models.effects.vibration_mode import VibrationMode
from piezo_models.identified_model import IdentifiedModel
from piezo_recorder.reading.reader import read_recording
from piezo_recorder.reading.recording import Recording
from piezo_studies.measured_devices.measured import Figure
from piezo_studies.measured_devices.measured_diagnosis import Finding, finding_of

CIRCUIT_FILES = "circuit_cubic_spring/multisine.csv", "circuit_cubic_spring/arrow.csv"
"""Multisines, and the arrow."""

BOUC_WEN_FILES = ("bouc_wen/train_multisine.csv", "bouc_wen/test_multisine_two_periods.csv",
                  "bouc_wen/test_sweep.csv")
"""Training data, test multisine, and sweep."""

FITTED_PART = 0.7
"""Fraction of a recording that is fitted; the rest is predicted."""

NOISE_UM = 8.0
"""RMS noise added to the training data of Bouc-Wen, as the benchmark prescribes."""

MV_PER_UM = 1e3
"""Conversion of displacements to voltages of the circuit: the files store 1 V as 1 um."""


def circuit(directory: Path) -> tuple[list[Figure], list[Finding]]:
    """Identify the circuit on multisines, diagnose it, and predict further ones and the arrow."""
    multisine, arrow = (read_recording(Path(directory) / name) for name in CIRCUIT_FILES)
    fitted, unseen = divided(multisine)
    identified = identify(dynamics=fitted)
    fitted, unseen, arrow = (_aligned(identified, each) for each in (fitted, unseen, arrow))
    diagnosis = diagnose(identified.model, [fitted], arrow)
    figures = []
    for name, tested, linear_mv, most_linear_mv, nonlinear_mv in (
            ("further multisines", unseen, 6.7, 7.0, 0.30), ("arrow", arrow, 14.5, 14.5, 0.60)):
        before, after = (MV_PER_UM * rms_um(model, tested)
                         for model in (identified.model, diagnosis.model))
        figures += [
            Figure("circuit", "RMS, linear", "multisines", name, "mV", linear_mv, most_linear_mv,
                   before, f"mode of {_frequency_hz(identified.model):.2f} Hz"),
            Figure("circuit", "RMS, diagnosed", "multisines", name, "mV", nonlinear_mv,
                   nonlinear_mv, after, "the best published"),
        ]
    return figures, [finding_of("circuit", "linear", diagnosis, "the arrow")]


def bouc_wen(directory: Path) -> tuple[list[Figure], list[Finding]]:
    """Identify the hysteretic oscillator on noisy multisines, diagnose it, and predict unseen data.

    The training data have no noise; the benchmark's rules add `NOISE_UM` RMS.
    """
    train, multisine, sweep = (
        read_recording(Path(directory) / name)
        for name in BOUC_WEN_FILES)
    noise_um = NOISE_UM * np.random.default_rng(0).normal(size=train.displacement_um.size)
    train = replace(train, displacement_um=train.displacement_um + noise_um)
    identified = identify(dynamics=train)
    train, multisine, sweep = (_aligned(identified, each) for each in (train, multisine, sweep))
    diagnosis = diagnose(identified.model, [train], multisine)
    figures = []
    for name, tested, bounds in (("test multisine", multisine, (34.0, 10.0)),
                                 ("sweep", sweep, (50.0, 10.0))):
        travel_um = float(np.std(tested.displacement_um))
        before, after = (100.0 * rms_um(each, tested) / travel_um
                         for each in (identified.model, diagnosis.model))
        figures += [
            Figure("Bouc-Wen", "RMS over that of the output, linear", "multisine", name, "%", 33.0,
                   bounds[0], before, f"mode of {_frequency_hz(identified.model):.2f} Hz"),
            Figure("Bouc-Wen", "RMS over that of the output, diagnosed", "multisine", name, "%",
                   1.8, bounds[1], after, f"{0.01 * after * travel_um:.2g} um; the best published, "
                   "12 um with 217 parameters, is a black box, ours has the form of the equation"),
        ]
    return figures, [finding_of("Bouc-Wen", "linear", diagnosis, "the test multisine")]


def _aligned(identified: IdentifiedModel, recording: Recording) -> Recording:
    return read_as_identified(identified, recording)[0]


def divided(whole: Recording) -> tuple[Recording, Recording]:
    """Return the fitted part of a recording, and the rest."""
    sample = np.arange(whole.voltage_v.size)
    is_fitted = sample < FITTED_PART * sample.size
    return whole.select(is_fitted), whole.select(~is_fitted)


def rms_um(model: StageModel, recording: Recording) -> float:
    """Return the RMS error of a prediction with the offset removed."""
    prediction = predict(model, recording)
    return float(np.std((prediction.measured_um - prediction.simulated_um)[prediction.good]))


def _frequency_hz(model: StageModel) -> float:
    """Return the frequency of the slowest mode, in series or in parallel."""
    further = [effect.frequency_rad_per_s for effect in model.effects
               if isinstance(effect, VibrationMode)]
    return min((*model.dynamics.mode_frequencies_rad_per_s, *further)) / (2.0 * np.pi)
