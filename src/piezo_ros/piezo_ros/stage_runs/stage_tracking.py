# SPDX-License-Identifier: BSD-3-Clause
"""Make the stage play a feedforward, and respond to its blocks meanwhile."""

import array
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress

from piezo_interfaces.msg import FeedbackLaw, FeedbackVoltage, SampleBlock
from piezo_interfaces.srv import (
    LoadFeedback,
    LoadFeedforward,
    ReplaceFeedforward,
    StartTracking,
)
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from std_srvs.srv import Trigger

from piezo_common.arrays import FloatArray
from piezo_ros.quality import FEEDBACK, SAMPLES
from piezo_ros.requests.calls import CallFailed, NoAnswer, call_service
from piezo_ros.stage_runs.stage_watch import StageWatch
from piezo_ros.stage_runs.streaming import More, Stream

REPORT_PERIOD_S = 0.1
SILENCE_TIMEOUT_S = 10.0
# For a stage that was there a moment ago.
APPEARANCE_S = 1.0
STOP_TIMEOUT_S = 10.0
# A node that ends may be gone before its last samples are read.
LAST_BLOCK_S = 1.0


class StageTracker:
    """Run the stage's feedforward and feedback, one run at a time.

    `last_sample` is the last sample of the last run, including the return to rest; it is 0 until
    the stage is at rest. `missed_feedback` counts the responses of the last run that the stage
    missed.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._take: Callable[[SampleBlock], float] | None = None
        self._stream: Stream | None = None
        # Responses to the first blocks wait here until the number of their run is known.
        self._early_answers: list[tuple[int, float]] = []
        self._run: int | None = None
        self._first_tick = 0
        self._numbering = threading.Lock()
        self._client = node.get_fully_qualified_name()
        self._stage = StageWatch(node)
        self._at_rest, self._awake, self._begun = (threading.Event() for _ in range(3))
        self.last_sample = self.missed_feedback = 0
        self._feedback = node.create_publisher(FeedbackVoltage, "feedback", FEEDBACK)
        # Raw messages, as blocks between two runs are not read.
        node.create_subscription(SampleBlock, "samples", self._on_samples, SAMPLES, raw=True)
        self._load = node.create_client(LoadFeedforward, "load_feedforward")
        self._load_law = node.create_client(LoadFeedback, "load_feedback")
        self._replace = node.create_client(ReplaceFeedforward, "replace_feedforward")
        self._start = node.create_client(StartTracking, "start_tracking")
        self._stop = node.create_client(Trigger, "stop_tracking")

    def run(self, once_voltage_v: FloatArray, period_voltage_v: FloatArray, ticks: int,
            take: Callable[[SampleBlock], float], answering: bool, cancelled: Callable[[], bool],
            report: Callable[[], object], more: More | None = None,
            law: FeedbackLaw | None = None, axes: Sequence[str] = (),
            marks: tuple[bytes, bytes] = (b"", b"")) -> None:
        """Play a feedforward for some ticks and wait until the stage is at rest.

        The voltages are as in `LoadFeedforward`, or of shape (n, axes). Their marks are as in that
        message: a byte for each sample of all axes, or none. The run lasts `ticks`, or with 0 until
        it is cancelled. `cancelled` is called periodically, and True stops the run. `report` is
        called periodically, and once the stage is at rest.

        `take` is called with each `SampleBlock` of the run, and returns the response, a voltage in
        V. With `answering`, the stage waits for the responses and adds them. `more` is the source
        of the streamed feedforward after ``once_voltage_v``, see `Stream`; the blocks are then
        always answered. If the stage evaluates a law by itself, there are no responses. If it has
        several axes, `axes` names all of them, and the blocks are not answered.

        Raise CallFailed if the stage rejects the run, sends no samples, or is gone.
        """
        self._stage.begin()
        for event in self._at_rest, self._awake, self._begun:
            event.clear()
        self._blocks = self.last_sample = self.missed_feedback = self._feedforward_id = 0
        self._load_voltages(once_voltage_v, period_voltage_v, axes=axes, marks=marks)
        if law is not None:
            call_service(self._node, self._load_law, LoadFeedback.Request(
                law=law, feedforward_id=self._feedforward_id))
        self._stream = more and Stream(more, len(once_voltage_v), self._append, self._publish)
        self._answering = answering or more is not None
        self._take = take
        try:
            if self._stream:
                self._stream.feed()
            self._run, self._early_answers = None, []
            begun = self._begin(StartTracking.Request(
                feedback=self._answering, onboard=law is not None, ticks=ticks,
                client=self._client, feedforward_id=self._feedforward_id))
            self._first_tick = begun.first_tick
            self._begin_answers(begun.run)
            self._begun.set()
            self._wait(cancelled, report)
        finally:
            self._take = self._stream = None

    def replace(self, once_voltage_v: FloatArray, period_voltage_v: FloatArray,
                law: FeedbackLaw | None) -> int:
        """Replace feedforward and law of the present run in one tick; callable from any thread.

        They are those of `run`, with the same length as what plays. Returned are the ticks from the
        beginning of the run to the replacement. Raises `CallFailed` if nothing runs, or the stage
        rejects it; the run then continues unchanged.
        """
        if not self._begun.wait(STOP_TIMEOUT_S):
            raise CallFailed(f"no run began within {STOP_TIMEOUT_S:g} s: start one first")
        replaced = call_service(self._node, self._replace, ReplaceFeedforward.Request(
            run=self._run, once_voltage_v=array.array("d", bytes(once_voltage_v)),
            period_voltage_v=array.array("d", bytes(period_voltage_v)),
            onboard=law is not None, law=law or FeedbackLaw()), appearance_s=APPEARANCE_S)
        return replaced.first_tick - self._first_tick

    def wake(self) -> None:
        """Check at once whether further voltages of a stream are available; from any thread."""
        self._awake.set()

    def why_ended(self) -> str:
        """Return why the stage ended the last run early, as far as it reports that."""
        return self._stage.why_ended()

    def _begin(self, request: StartTracking.Request) -> StartTracking.Response:
        try:
            return call_service(self._node, self._start, request, appearance_s=APPEARANCE_S)
        except NoAnswer:
            self._stop.call_async(Trigger.Request())  # the run may have started nevertheless
            raise

    def _load_voltages(self, once_voltage_v: FloatArray, period_voltage_v: FloatArray | bytes = b"",
                       append: bool = False, axes: Sequence[str] = (),
                       marks: tuple[bytes, bytes] = (b"", b"")) -> None:
        self._feedforward_id = call_service(self._node, self._load, LoadFeedforward.Request(
            once_voltage_v=array.array("d", bytes(once_voltage_v)),
            period_voltage_v=array.array("d", bytes(period_voltage_v)), append=append,
            feedforward_id=self._feedforward_id, axes=list(axes),
            once_marks=array.array("B", marks[0]), period_marks=array.array("B", marks[1]))
        ).feedforward_id

    def _append(self, voltage_v: FloatArray) -> None:
        self._load_voltages(voltage_v, append=True)

    def _publish(self, tick: int, voltage_v: float) -> None:
        with self._numbering:
            if self._run is None:
                self._early_answers.append((tick, voltage_v))
                return
        self._feedback.publish(FeedbackVoltage(tick=tick, voltage_v=voltage_v, run=self._run))

    def _begin_answers(self, run: int) -> None:
        with self._numbering:
            self._run, early = run, self._early_answers
        for tick, voltage_v in early:
            self._publish(tick, voltage_v)

    def _wait(self, cancelled: Callable[[], bool], report: Callable[[], object]) -> None:
        blocks_before, heard_s, reported_s = 0, time.monotonic(), 0.0
        stopping, failure = False, None
        while not self._at_rest.is_set():
            self._awake.wait(REPORT_PERIOD_S)
            self._awake.clear()
            if self._stream and not stopping:
                try:
                    self._stream.feed()
                except ValueError as error:
                    failure = error
            if (failure or cancelled()) and not stopping:
                stopping = True
                with suppress(CallFailed):  # the stage may just have stopped by itself
                    call_service(self._node, self._stop, Trigger.Request(), STOP_TIMEOUT_S,
                                 APPEARANCE_S)
            if self._stage.gone and not self._at_rest.wait(LAST_BLOCK_S):
                raise CallFailed(f"the stage stopped before the end: {self.why_ended()}")
            now_s = time.monotonic()
            if self._blocks != blocks_before:
                blocks_before, heard_s = self._blocks, now_s
            elif now_s - heard_s > SILENCE_TIMEOUT_S:
                # A reader that hangs may block the stage; nothing would supervise it once it
                # continues.
                self._stop.call_async(Trigger.Request())
                raise CallFailed(f"the stage sent no samples for {SILENCE_TIMEOUT_S:g} s: "
                                 "look whether its node runs")
            if now_s - reported_s >= REPORT_PERIOD_S:
                reported_s = now_s
                report()
        report()
        if isinstance(failure, CallFailed) and self._stage.stopped:
            # The stage had stopped, and therefore rejected the next part of the stream.
            raise CallFailed(f"the stage stopped before the end: {self._stage.stopped}")
        if failure:
            raise failure

    def _on_samples(self, raw: bytes) -> None:
        take = self._take
        if take is None:
            return
        block = deserialize_message(raw, SampleBlock)
        if block.flags & SampleBlock.FLAG_TRACKING:
            self._blocks += 1
            self.missed_feedback = block.missed_feedback
            voltage_v, stream = take(block), self._stream
            if stream:
                stream.answer(block.tick, voltage_v, len(block.displacement_um))
                if stream.wants_more:
                    self._awake.set()
            elif self._answering:
                self._publish(block.tick, voltage_v)
        elif self._blocks and not block.flags & SampleBlock.FLAG_RAMPING:
            samples = len(block.displacement_um) // max(len(block.axes), 1)
            self.last_sample = block.first_sample + samples - 1
            self._at_rest.set()
            self._awake.set()
