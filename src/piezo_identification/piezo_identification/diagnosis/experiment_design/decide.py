# SPDX-License-Identifier: BSD-3-Clause
"""Play what tells the alternatives apart, and diagnose again, until one is left."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from piezo_identification.diagnosis.diagnose import Diagnosis, diagnose
from piezo_identification.diagnosis.experiment_design.alternatives import find_alternatives
from piezo_identification.diagnosis.experiment_design.expected_outcome import SURE
from piezo_identification.diagnosis.experiment_design.propose import LONGEST_S, Proposal, propose
from piezo_identification.experiments.catalogue import Experiment
from piezo_identification.experiments.stage_limits import USUAL_LIMITS, StageLimits
from piezo_models.cascade import StageModel
from piezo_recorder.reading.recording import Recording


@dataclass(frozen=True, eq=False)
class DecisionStep:
    """A diagnosis on the way to a decision.

    Attributes
    ----------
    diagnosis : Diagnosis
        On all recordings up to then.
    probabilities : dict of str to float
        Of the alternatives that it leaves.
    proposal : Proposal or None
        What was played next; None where the decision was made or the budget spent.
    """

    diagnosis: Diagnosis
    probabilities: dict[str, float]
    proposal: Proposal | None

    @property
    def is_decided(self) -> bool:
        """Tell whether one alternative is sure enough, or no other is left."""
        return max(self.probabilities.values()) >= SURE


def decide(model: StageModel, recordings: Sequence[Recording],
           play: Callable[[Experiment], Recording], budget: int,
           limits: StageLimits = USUAL_LIMITS, longest_s: float = LONGEST_S) -> list[DecisionStep]:
    """Diagnose, play what tells the alternatives apart, and diagnose again.

    Parameters
    ----------
    model : StageModel
    recordings : sequence of Recording
        So far.
    play : callable
        Plays an experiment on the stage and returns the recording.
    budget : int
        Recordings that may be made.
    limits : StageLimits
    longest_s : float
        That each may last.

    Returns
    -------
    list of DecisionStep
        The last one has the decision, if there is one.
    """
    known = list(recordings)
    steps: list[DecisionStep] = []
    while True:
        diagnosis = diagnose(model, known)
        alternatives = find_alternatives(diagnosis.selection.regression, diagnosis.document())
        step = DecisionStep(diagnosis, alternatives.probabilities, None)
        proposal = None
        if not step.is_decided and len(steps) < budget:
            proposal = propose(alternatives, limits, longest_s)
        steps.append(DecisionStep(diagnosis, alternatives.probabilities, proposal))
        if proposal is None:
            return steps
        known.append(play(proposal.experiment))
