# SPDX-License-Identifier: BSD-3-Clause
"""Run the controller's model next to the stage, report when it no longer fits, offer another."""

from datetime import datetime
from pathlib import Path

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from piezo_interfaces.msg import ExtendedModel, SampleBlock, StageDescription
from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.serialization import deserialize_message
from std_msgs.msg import String

from piezo_identification.monitoring.explain_change import Explainer
from piezo_identification.monitoring.model_monitor import MonitorSettings, Suspicion
from piezo_identification.monitoring.stage_monitor import StageMonitor
from piezo_identification.monitoring.usual_error import known_error
from piezo_models.model_file import load_model
from piezo_ros.diagnostics import diagnostic
from piezo_ros.parameters import declare, declare_data_root
from piezo_ros.quality import DESCRIPTION, SAMPLES
from piezo_ros.spinning import autostart, run_node
from piezo_ros.stage_runs.described_stage import DescribedStage

DIAGNOSTICS_PERIOD_S = 1.0


class MonitorNode(LifecycleNode):
    """Monitor every run of the loop, and diagnose changes in the background."""

    def __init__(self) -> None:
        super().__init__("monitor")
        defaults = MonitorSettings()
        self._settings = MonitorSettings(
            block_s=declare(self, "block_s", defaults.block_s, "Length of a block whose residual "
                            "is tested: a few periods of what is tracked (s).", 0.001, 60.0),
            learning_blocks=declare(
                self, "learning_blocks", defaults.learning_blocks,
                "Blocks of a kind of motion of which it is learned what is usual.", 10, 100_000),
            false_alarms_per_hour=declare(
                self, "false_alarms_per_hour", defaults.false_alarms_per_hour,
                "Most false alarms while nothing changes (1/h).", 1e-6, 100.0))
        self._kept_s = declare(self, "kept_s", 10.0, "How much of the past is kept for a "
                               "diagnosis (s).", 0.1, 600.0)
        self._diagnosed_s = declare(
            self, "diagnosed_s", 2.0,
            "How much of a run after a change is diagnosed; 0 for no diagnosis (s).", 0.0, 600.0)
        self._data_root = declare_data_root(self)
        self._directory = declare(self, "directory", "runs/monitor", "Where diagnoses are kept.")
        self._active = False
        self._stage = DescribedStage(self, self._begin)
        self._model_path = ""
        self._monitor: StageMonitor | None = None
        self._why_blind = "waits for the model of a run"
        self._explainer: Explainer | None = None
        self._forget()
        self._offers = self.create_publisher(
            ExtendedModel, "monitor/extended_model", DESCRIPTION)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.create_subscription(String, "controller/model", self._use_model, DESCRIPTION)
        # Raw, as blocks are not deserialized before there is a model.
        self.create_subscription(SampleBlock, "samples", self._take, SAMPLES, raw=True)
        self.create_timer(DIAGNOSTICS_PERIOD_S, self._report,
                          clock=Clock(clock_type=ClockType.STEADY_TIME))
        autostart(self)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Start monitoring."""
        self._active = True
        self._begin()
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop monitoring, and end a running diagnosis."""
        self._active = False
        self._begin()
        return super().on_deactivate(state)

    on_shutdown = on_deactivate

    def close(self) -> None:
        """End a running diagnosis."""
        self._forget()

    def _forget(self) -> None:
        """Discard the reported changes, and end a running diagnosis."""
        if self._explainer is not None:
            self._explainer.end()
        self._first: Suspicion | None = None
        self._last: Suspicion | None = None
        self._explainer = None
        self._offer: ExtendedModel | None = None
        self._found = ""

    def _use_model(self, message: String) -> None:
        """Monitor with the model that the controller uses from now on."""
        if message.data != self._model_path:
            self._model_path = message.data
            self._begin()

    def _begin(self, _: StageDescription | None = None) -> None:
        """Restart with the present model and the present stage."""
        self._forget()
        self._monitor, described = None, self._stage.description
        if not (self._active and self._model_path and described):
            return
        try:
            if self._stage.too_many_axes:
                raise ValueError(self._stage.too_many_axes)
            identified = load_model(self._model_path)
            self._monitor = StageMonitor(
                identified.model, described.sample_rate_hz, self._settings, self._kept_s,
                described.rest_voltage_v, known_error(identified))
        except ValueError as error:
            self._why_blind = str(error)
            self.get_logger().error(f"cannot watch the stage: {error}")
        self._report()

    def _take(self, raw: bytes) -> None:
        monitor = self._monitor
        if monitor is None:
            return
        block = deserialize_message(raw, SampleBlock)
        raised = monitor.take(
            block.first_sample, block.sample_period_s, np.frombuffer(block.voltage_v),
            np.frombuffer(block.displacement_um), block.flags)
        if raised:
            self._last = raised[-1]
            self._first = self._first or raised[0]
            self.get_logger().warning(f"the model no longer fits: {self._last.sentence()}")
            self._report()
        if self._first and self._diagnosed_s and not (self._explainer or self._found):
            wanted = self._diagnosed_s * monitor.sample_rate_hz
            if monitor.samples_since(self._first.at_s) >= wanted:
                self._explain(monitor, self._first)

    def _explain(self, monitor: StageMonitor, first: Suspicion) -> None:
        """Start to diagnose the samples recorded since the alarm."""
        name = datetime.now().astimezone().strftime("change_%Y%m%d_%H%M%S_%f")
        try:
            directory = self._data_root.writable(Path(self._directory, name))
            self._explainer = Explainer(self._model_path, monitor.recording(first.at_s), directory,
                                        first.usual_rms_um)
        except (OSError, ValueError) as error:
            self._found = f"the change cannot be diagnosed: {error}"
            self.get_logger().error(self._found)

    def _take_explanation(self) -> None:
        """Offer the result of the diagnosis once it has ended."""
        explainer, first = self._explainer, self._first
        if explainer is None or first is None:
            return
        explanation = explainer.explanation
        if explanation is None:
            return
        self._explainer, self._found = None, explanation.sentence
        self.get_logger().warning(explanation.sentence)
        if explanation.extended_model:
            self._offer = ExtendedModel(
                model=self._model_path, extended_model=explanation.extended_model,
                sentence=explanation.sentence, since_s=first.since_s,
                usual_rms_um=first.usual_rms_um, before_rms_um=explanation.before_rms_um,
                after_rms_um=explanation.after_rms_um)
            self._offers.publish(self._offer)

    def _report(self) -> None:
        """Publish the reported change and the state of its diagnosis."""
        self._take_explanation()
        level, message = self._state()
        values: dict[str, object] = {"model": self._model_path}
        if self._monitor is not None:
            values["lost_samples"] = self._monitor.lost_samples
            values["watched_until_s"] = f"{self._monitor.watched_until_s:.3f}"
        if (last := self._last) is not None:
            values |= {
                "since_s": f"{last.since_s:.3f}", "suspected_s": f"{last.at_s:.3f}",
                "statistic": last.statistic, "probability": f"{last.probability:.6f}",
                "usual_rms_um": f"{last.usual_rms_um:.6f}", "rms_um": f"{last.rms_um:.6f}",
                "band_hz": "{:g} to {:g}".format(*last.band_hz), "found": self._found}
        if self._offer is not None:
            values["extended_model"] = self._offer.extended_model
        self._diagnostics.publish(diagnostic(self, "model", level, message, values))

    def _state(self) -> tuple[bytes, str]:
        if not self._active:
            return DiagnosticStatus.OK, "not active: activate it first"
        if self._monitor is None:
            return DiagnosticStatus.STALE, self._why_blind
        if self._last is None:
            learning = "learns what is usual" if self._monitor.is_learning else "the model fits"
            return DiagnosticStatus.OK, learning
        done = ("an extended model is offered: accept_extended_model" if self._offer
                else "a diagnosis runs" if self._explainer
                else "no model explains it" if self._found else "more samples are needed")
        return DiagnosticStatus.WARN, f"{self._last.sentence()}; {done}"


def main(args: list[str] | None = None) -> None:
    """Run the node ``monitor``."""
    run_node(MonitorNode, args)
