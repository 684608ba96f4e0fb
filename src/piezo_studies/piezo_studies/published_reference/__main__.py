# SPDX-License-Identifier: BSD-3-Clause
"""Follow a reference that is known before the run, or published during it with several previews."""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_controller.feedback.feedback_design import FeedbackController, design_feedback
from piezo_controller.feedback.multirate_feedback import MultirateFeedback
from piezo_controller.feedback.synthesis.weights import load_weights
from piezo_controller.feedforward.live import LivePlan, plan_live
from piezo_controller.feedforward.streamed import StreamPlan, plan_stream
from piezo_controller.references.live_reference import LiveReference
from piezo_controller.references.reference import Reference, trajectory
from piezo_controller.references.trajectory import Trajectory
from piezo_controller.tracking.tracking_modes import StageClock
from piezo_controller.tracking.tracking_run import TrackingRun
from piezo_models.cascade import StageModel
from piezo_sim.simulated_stage import SimulatedStage
from piezo_studies.marked_sections import write_sections
from piezo_studies.tables import markdown_table
from piezo_studies.thesis.identified_stage import identified_stage

PREVIEWS = (0, 5, 20)
BAND_HZ, AMPLITUDE_UM, CENTRE_UM = 100.0, 20.0, 52.0
DURATION_S, SETTLING_S = 2.0, 0.2
CLOCK = StageClock()
MAX_FEEDBACK_V = 20.0


@dataclass(frozen=True)
class Followed:
    """The errors of one run."""

    preview_samples: int | None
    """Preview; None if the reference was known before the run."""
    composite: bool
    """Whether feedback was used."""
    e_rms_percent: float
    largest_error_um: float
    """Errors by the sensor after `SETTLING_S`; e_rms is relative to `AMPLITUDE_UM`."""
    model_e_rms_percent: float
    """Error of the feedforward on the model itself, without noise."""
    delay_s: float
    """Time from the publication of the reference until it is followed."""


class _Publisher:
    """Publish a reference tick by tick while the stage plays."""

    def __init__(self, reference: Trajectory, preview_samples: int) -> None:
        self.live = LiveReference(CLOCK.sample_period_s)
        self._reference, self._preview_samples, self._sent = reference, preview_samples, 0
        self.publish()

    def publish(self) -> None:
        """Publish the next tick."""
        count = CLOCK.samples_per_tick
        self.live.take(self._sent, 0.0, self._preview_samples,
                       self._reference.sample(self._sent, count))
        self._sent += count


def compare(model: StageModel, seed: int = 11, duration_s: float = DURATION_S) -> list[Followed]:
    """Follow one reference with every preview, without and with feedback."""
    reference = trajectory(Reference(
        "random", (BAND_HZ,), (AMPLITUDE_UM,), (), CENTRE_UM, seed=seed))
    samples = round(duration_s * CLOCK.sample_rate_hz)
    rows = []
    for composite in (False, True):
        plan = plan_stream(reference, samples, model)
        rows.append(_play(plan, None, model, samples, composite, None))
        for preview_samples in PREVIEWS:
            publisher = _Publisher(reference, preview_samples)
            live_plan = plan_live(publisher.live, BAND_HZ, AMPLITUDE_UM, samples, model)
            rows.append(_play(live_plan, publisher, model, samples, composite, preview_samples))
    return rows


def _play(plan: LivePlan | StreamPlan, publisher: _Publisher | None, model: StageModel,
          samples: int, composite: bool, preview_samples: int | None) -> Followed:
    """Play a plan tick by tick; the feedback acts in the tick after the next."""
    feedback = MultirateFeedback(_controller(model), MAX_FEEDBACK_V) if composite else None
    run = TrackingRun(plan, samples, feedback, CLOCK.tick_s)
    stage = SimulatedStage(seed=7)
    stage.open()
    more, expected = plan.continuation(), []
    tick, feedback_v = CLOCK.samples_per_tick, [0.0, 0.0]
    ticks = run.total_samples // tick
    planned_v, measured, waiting_v = [], [], plan.once_voltage_v
    for _ in range(ticks):
        # A live plan gives only due voltages; a stream would give all of its chunks.
        while waiting_v.size < tick or publisher is not None:
            chunk_v = more()
            if chunk_v is None or not chunk_v.size:
                break
            waiting_v = np.r_[waiting_v, chunk_v]
        planned_v.append(waiting_v[:tick])
        waiting_v = waiting_v[tick:]
        expected.append(plan.expected_um(run.samples, tick))
        displacement_um = stage.exchange(planned_v[-1] + feedback_v.pop(0))
        measured.append(displacement_um)
        plan.take(displacement_um)
        feedback_v.append(run.take(displacement_um))
        if publisher is not None:
            publisher.publish()
    counted = slice(plan.begin_sample + round(SETTLING_S * CLOCK.sample_rate_hz), None)
    wanted_um = np.concatenate(expected)[counted]
    error_um = np.concatenate(measured)[counted] - wanted_um
    left_um = model.simulate(np.concatenate(planned_v), CLOCK.sample_period_s)[counted] - wanted_um
    delay_s = getattr(plan, "delay_samples", 0) * CLOCK.sample_period_s
    return Followed(preview_samples, composite, _percent(error_um),
                    float(np.abs(error_um).max()), _percent(left_um), delay_s)


def _percent(error_um: FloatArray) -> float:
    return float(100.0 * np.sqrt(np.mean(error_um**2)) / AMPLITUDE_UM)


def _controller(model: StageModel) -> FeedbackController:
    return design_feedback(model, load_weights(), CLOCK.sample_period_s)


def table(rows: Sequence[Followed]) -> str:
    """Return the rows as a Markdown table."""
    return markdown_table(
        ("reference", "feedback", "e_rms by the sensor", "largest error",
         "feedforward alone on its own model", "late by"),
        [("known before the run" if row.preview_samples is None else
          f"published, {row.preview_samples} samples of preview",
          "H-infinity, 1 kHz" if row.composite else "none", f"{row.e_rms_percent:.3f} %",
          f"{1e3 * row.largest_error_um:.0f} nm", f"{row.model_e_rms_percent:.4f} %",
          f"{1e3 * row.delay_s:.1f} ms") for row in rows])


SECTION = "published references"
"""Mark of the table in the page."""


def main(arguments: list[str] | None = None) -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(prog="published_reference", description=__doc__)
    parser.add_argument("--page", type=Path, default=Path("docs/published_reference.md"),
                        help="page whose table is written again; its text stays")
    options = parser.parse_args(arguments)
    rows = compare(identified_stage())
    write_sections(options.page, {SECTION: table(rows)})
    print(f"{len(rows)} runs: {options.page}")


if __name__ == "__main__":
    main()
