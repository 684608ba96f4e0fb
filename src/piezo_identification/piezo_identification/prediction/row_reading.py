# SPDX-License-Identifier: BSD-3-Clause
"""Align the rows of recordings like those of the identification if the model then fits better."""

from collections.abc import Iterable, Sequence

import numpy as np

from piezo_identification.conditioning.outlier_samples import outlier_text
from piezo_identification.conditioning.row_alignment import (
    may_be_straight,
    read_as,
    reading_at_jumps,
    rows_read_at_start,
    with_straight_voltage,
)
from piezo_identification.conditioning.segments import longest_stretch
from piezo_identification.conditioning.sensor_sign import sign_text
from piezo_identification.prediction.prediction import Prediction, predict
from piezo_identification.simulation.past_search import after_saturation, conditioned
from piezo_identification.simulation.simulated_recording import PastVoltages
from piezo_models.cascade import StageModel
from piezo_models.identified_model import IdentifiedModel
from piezo_recorder.reading.recording import Recording

MOST_GAIN_CHANGE = 3.0
"""Largest factor between the travels of a recording and of its model that is no error of the units:
loads and ageing change the gain of a stage by less, another unit or a monitor output by ten."""


def read_as_identified(identified: IdentifiedModel,
                       recording: Recording) -> tuple[Recording, float]:
    """Align the rows of a recording with a reading time from the identification.

    A model file states when the rows of its recordings were read. A further recording may be of the
    same logger or of another one, so its rows are aligned only if the model then fits better.
    Return the aligned recording, and when its rows were read, in sample periods after the voltage
    of a row changed. Raise ValueError if the recording has gaps, or is too short.
    """
    return read_as_explained(
        identified.model, recording,
        [row["read_at_samples"] for row in identified.rows.values()],
        any(row.get("is_straight") for row in identified.rows.values()))


def all_as_identified(
    model: IdentifiedModel | StageModel, recordings: Iterable[Recording],
    declared_at_samples: float = 0.0,
) -> tuple[list[Recording], list[str]]:
    """Align the rows of recordings with a given reading time, or else like the identification.

    `declared_at_samples` is the given time, in sample periods after the voltage of a row; 0 if not
    given. For a `StageModel`, which has no reading times, the rows are then unchanged. Also return
    a sentence on each recording whose rows were aligned because the model then fits better. Raise
    ValueError if a recording has gaps, or is too short.
    """
    aligned, sentences = [], []
    for recording in recordings:
        if declared_at_samples or isinstance(model, StageModel):
            aligned.append(rows_read_at_start(recording, declared_at_samples))
            continue
        read, read_at = read_as_identified(model, recording)
        aligned.append(read)
        if read_at:
            sentences.append(
                f"{recording.path}: rows are taken to be read {read_at:.4g} sample periods after "
                "their voltage, which the model explains better")
        elif read is not recording:
            sentences.append(f"{recording.path}: the voltage is taken as straight between the "
                             "rows, which the model explains better")
    return aligned, sentences


def predict_as_identified(
    model: IdentifiedModel | StageModel, recording: Recording, declared_at_samples: float = 0.0,
) -> tuple[Prediction, list[str]]:
    """Simulate a model for a recording whose rows are aligned by `all_as_identified`.

    Of a recording with gaps the longest stretch between them is simulated. Also return sentences on
    gaps, on the assumed reading time, sign, outliers and past, and on units. Raise ValueError if
    the recording, or its longest stretch, is too short.
    """
    recording, sentences = longest_stretch(recording)
    (read,), more = all_as_identified(model, [recording], declared_at_samples)
    sentences += more
    prediction = predict(model if isinstance(model, StageModel) else model.model, read)
    if prediction.reversed:
        sentences.append(sign_text(recording.path))
    if not prediction.good.all():
        sentences.append(outlier_text(recording.path, ~prediction.good, prediction.time_s))
    if prediction.past_v:
        sentences.append(f"{recording.path}: it does not begin saturated: taken to have "
                         f"{_of_past(prediction.past_v)}")
    return prediction, [*sentences, *_gain_sentences(prediction, recording.path)]


def _of_past(past_v: PastVoltages) -> str:
    """Return how a stage reached the first voltage: by two extremes, or by ever smaller swings."""
    if len(past_v) == 2:
        return "come from {:.4g} V by way of {:.4g} V".format(*past_v)
    return f"been demagnetised about {past_v[-1]:.4g} V"


def _gain_sentences(prediction: Prediction, path: str) -> list[str]:
    """Return the question whether units are wrong, if the travel is that of another stage."""
    measured_um, simulated_um = (float(np.ptp(signal[prediction.good])) for signal in (
        prediction.measured_um, prediction.simulated_um))
    if simulated_um / MOST_GAIN_CHANGE <= measured_um <= simulated_um * MOST_GAIN_CHANGE:
        return []
    return [f"{path}: the displacement travels {measured_um:.4g} um, that of the model "
            f"{simulated_um:.4g} um: are voltage and displacement in the units of the "
            "identification?"]


def read_as_explained(
    model: StageModel, recording: Recording, read_at_samples: Sequence[float],
    some_are_straight: bool = False,
) -> tuple[Recording, float]:
    """Align the rows of a recording with the reading time for which a model fits best; return both.

    Reading times are given in sample periods after the voltage of a row changed; 0 and the time
    that jumps show are always tried. If some recordings of the identification had a voltage that is
    straight between the rows, that is tried, too. Raise ValueError if the recording has gaps, or is
    too short.
    """
    instants = {read_as(recording, instant) for instant in read_at_samples}
    instants |= {reading_at_jumps(recording) or 0.0}
    tried = [(rows_read_at_start(recording, instant), instant)
             for instant in sorted({0.0, *instants})]
    if some_are_straight and may_be_straight(recording):
        tried.append((with_straight_voltage(recording), 0.0))
    if len(tried) == 1:
        return recording, 0.0

    def error_um(entry: tuple[Recording, float]) -> float:
        signed, _ = conditioned(model, entry[0])
        return after_saturation(model, signed).error_um()

    return min(tried, key=error_um)
