# SPDX-License-Identifier: BSD-3-Clause
"""The run in progress, and how it switches to another model between two ticks."""

from collections.abc import Callable
from dataclasses import replace

from piezo_controller.tracking.accepted_models import ModelText
from piezo_controller.tracking.track import PreparedRun, TrackRequest
from piezo_ros.requests.calls import CallFailed
from piezo_ros.stage_runs.law_message import message_of
from piezo_ros.stage_runs.stage_tracking import StageTracker

FROM_THE_NEXT = "from the next run on"


class PresentRun:
    """Lets a run that the stage plays by itself switch to another model.

    A streamed or learned plan, and a feedback that answers, have state in this node: such a run
    keeps its model. `prepare` prepares the same request for another model, and raises ValueError if
    that is impossible. `ended` is set once the stage is at rest again.
    """

    def __init__(self, request: TrackRequest, named: ModelText, prepared: PreparedRun,
                 prepare: Callable[[TrackRequest], PreparedRun], tracker: StageTracker,
                 tick_s: float) -> None:
        self.named, self.ended = named, False
        self._request, self._prepared, self._prepare = request, prepared, prepare
        self._tracker, self._tick_s = tracker, tick_s
        self._notes: list[str] = []

    @property
    def note(self) -> str:
        """Return the remarks on the models for the result; may be empty."""
        return "; ".join(self._notes)

    def go_over(self, model: ModelText, publish: Callable[[ModelText], None]) -> str:
        """Replace feedforward and law by those for another model, in one tick; return from when on.

        `publish` is called once the stage has switched. Raises ValueError if the reference is out
        of reach with the model, or the stage refuses the new voltages or law; the run then
        continues as before.
        """
        kept = self._why_kept()
        if kept:
            return f"{FROM_THE_NEXT}, as this one {kept}"
        following = self._prepare(replace(
            self._request, model=model.path, model_sha256=model.sha256))
        plan, law = following.plan, following.law
        try:
            ticks = self._tracker.replace(
                plan.once_voltage_v, plan.period_voltage_v,
                None if law is None else message_of(law))
        except CallFailed:
            if self.ended or self._prepared.run.complete:  # meanwhile
                return FROM_THE_NEXT
            raise
        publish(model)
        when = f"from {ticks * self._tick_s:.3f} s of the present run on"
        self._notes.append(f"used {model.path} {when.replace('the present', 'this')}")
        return when

    def _why_kept(self) -> str:
        """Return why this run keeps its model; empty if it need not."""
        if self._prepared.learning is not None:
            return "learns"
        if self._prepared.plan.streamed:
            return "is streamed"
        return "is answered block by block" if self._prepared.feedback is not None else ""
