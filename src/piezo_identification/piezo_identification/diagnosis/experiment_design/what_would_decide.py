# SPDX-License-Identifier: BSD-3-Clause
"""The next experiment after a diagnosis that leaves several explanations; see `propose`."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from piezo_common.progress_part import Progress, part_of
from piezo_identification.diagnosis.diagnose import Diagnosis
from piezo_identification.diagnosis.experiment_design.alternative_explanations import (
    find_alternatives,
)
from piezo_identification.diagnosis.experiment_design.expected_outcome import SURE
from piezo_identification.diagnosis.experiment_design.propose import Proposal, propose
from piezo_identification.diagnosis.joint.identification_recordings import (
    IdentificationRecordings,
    old_recordings,
)
from piezo_identification.diagnosis.joint.probabilities import ALTERNATIVE, SOMETHING_ELSE
from piezo_identification.diagnosis.joint.probabilities import SETTINGS as PROBABILITIES
from piezo_identification.experiments.stage_limits import USUAL_LIMITS, StageLimits
from piezo_identification.fitting.dataset import Dataset

COMPARED = 0.3
"""Part of the work for estimating the alternatives."""


def several_remain(verdict: Mapping[str, Any]) -> bool:
    """Return whether a verdict (`verdict.json`) leaves several known explanations to decide.

    Returns
    -------
    bool
        Also False if something else is most probable, because no known effect predicts it.
    """
    shares = dict(verdict.get("probabilities") or {})
    if shares.pop(SOMETHING_ELSE, 0.0) >= PROBABILITIES.believed:
        return False
    likely = [share for share in shares.values() if share >= ALTERNATIVE]
    if likely and max(likely) < SURE * sum(likely):
        return True
    return bool(verdict.get("not_told_from"))


def what_would_decide(diagnosis: Diagnosis, identified_from: IdentificationRecordings,
                      progress: Progress) -> Proposal | None:
    """Design the recording that decides between the alternatives of a diagnosis.

    Returns
    -------
    Proposal or None
        None if fewer than two alternatives remain.
    """
    verdict = diagnosis.document()
    if diagnosis.selection.interrupted or not several_remain(verdict):
        return None
    regression = diagnosis.selection.regression
    progress("compare the alternatives", 0.0)
    alternatives = find_alternatives(
        regression, verdict, old_recordings(regression.dataset.model, identified_from),
        stated_um=diagnosis.stated_um)
    return propose(alternatives, recorded_limits(regression.dataset),
                   progress=part_of(progress, COMPARED, 1.0))


def recorded_limits(dataset: Dataset) -> StageLimits:
    """Return the voltages of the model as limits, and the clock of the fastest recording."""
    hysteresis = dataset.model.hysteresis
    lowest_v, highest_v = hysteresis.voltage_min_v, hysteresis.voltage_max_v
    return replace(
        USUAL_LIMITS, voltage_min_v=lowest_v, voltage_max_v=highest_v,
        rest_voltage_v=min(max(USUAL_LIMITS.rest_voltage_v, lowest_v), highest_v),
        sample_rate_hz=max(recording.sample_rate_hz for recording in dataset.recordings))
