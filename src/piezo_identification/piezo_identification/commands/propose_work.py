# SPDX-License-Identifier: BSD-3-Clause
"""The work of `propose`: fit the alternatives, design the waveform, write and print it."""

import argparse
import json
from pathlib import Path
from typing import Any

from piezo_common.command_line import print_next, print_progress
from piezo_identification.diagnosis.experiment_design.propose import (
    alternatives_of_files,
    propose,
    save_proposal,
)
from piezo_identification.diagnosis.joint.identification_recordings import (
    find_identification_recordings,
)
from piezo_identification.diagnosis.report.diagnosis_results import stated_error_um
from piezo_identification.experiments.stage_limits import StageLimits
from piezo_identification.prediction.row_reading import all_as_identified
from piezo_models.model_file import announced_model
from piezo_recorder.reading.data_options import columns_given, read_all_given
from piezo_recorder.reading.reader import read_recordings


def propose_given(options: argparse.Namespace) -> None:
    """Design the recording that decides between the alternatives, and write and print it."""
    verdict = _read_verdict(options.verdict)
    identified = announced_model(options.model)
    known = find_identification_recordings(
        identified, options.model, read_recordings, others=options.data)
    recordings, sentences = all_as_identified(identified, (
        recording for path in options.data for recording in read_all_given(path, options)))
    for sentence in sentences:
        print(sentence)
    limits = StageLimits(options.lowest_v, options.highest_v, options.slew_limit_v_per_s,
                         options.sample_rate_hz, options.rest_v)
    print_progress("fit the alternatives", 0.0)
    alternatives = alternatives_of_files(
        identified.model, recordings, verdict, known, stated_error_um(identified) or 0.0)
    proposal = propose(alternatives, limits, options.longest_s, print_progress)
    for alternative in alternatives.alternatives:
        print(f"{alternative.name:40}{100.0 * alternative.probability:6.1f} %")
    if proposal is None:
        print("one explanation remains: there is nothing to decide")
        return
    waveform, outcome = save_proposal(proposal, options.output)
    print(proposal.sentence())
    print(f"written {waveform} and {outcome}")
    print_next(options, "piezo_client", "stage", "play", waveform, "--output", options.output)
    print_next(options, "piezo_identification", "diagnose", "--model", options.model, "--data",
               *options.data, "<the recording of it>", *columns_given(options), "--output",
               options.output / "diagnosis")


def _read_verdict(path: Path) -> dict[str, Any]:
    try:
        verdict = json.loads(path.read_text(encoding="utf-8"))
    except (UnicodeDecodeError, json.JSONDecodeError):
        raise ValueError(f"{path} is no JSON: give the verdict.json of a diagnosis") from None
    if not isinstance(verdict, dict) or not isinstance(verdict.get("effects"), list):
        raise ValueError(f"{path} has no effects: give the verdict.json of a diagnosis")
    return verdict
