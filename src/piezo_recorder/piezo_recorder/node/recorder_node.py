# SPDX-License-Identifier: BSD-3-Clause
"""Node that records the stage's topics: services start_recording and stop_recording."""

import functools
import importlib
import shutil
import time
from collections.abc import Callable, Coroutine, Mapping
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from piezo_interfaces.msg import SampleBlock, StageDescription
from piezo_interfaces.srv import StartRecording, StopRecording
from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from rclpy.lifecycle.node import LifecycleState
from rclpy.node import Node
from rclpy.serialization import deserialize_message, serialize_message
from rclpy.subscription import Subscription
from rclpy.task import Future
from rclpy.timer import Timer

from piezo_common.data_root import DataRootError, check_file_name
from piezo_recorder import sample_block
from piezo_recorder.node.attached_files import read_attachments
from piezo_recorder.node.patience import Patience
from piezo_recorder.reading import tracked_reference
from piezo_recorder.writing.message_definition import MessageDefinition, installed_definition
from piezo_recorder.writing.quality_profiles import offered_profile
from piezo_recorder.writing.recording_session import RecordingSession
from piezo_recorder.writing.writer import FLUSH_PERIOD_S, RecordingWriter
from piezo_ros.clock_guard import keep_clock
from piezo_ros.deadlines import asks_the_same, why_too_late
from piezo_ros.diagnostics import diagnostic
from piezo_ros.late_responses import LateResponse, create_late_service
from piezo_ros.parameters import declare, declare_data_root
from piezo_ros.presence import Presence
from piezo_ros.quality import SAMPLES
from piezo_ros.spinning import autostart, run_node
from piezo_ros.stage_runs.described_stage import DescribedStage

DISCOVERY_TIMEOUT_S = 10.0
ARRIVAL_TIMEOUT_S = 5.0
QUIET_TIMEOUT_S = 0.5
POLL_PERIOD_S = 0.01
DIAGNOSTICS_PERIOD_S = 1.0
# Time from the loss of a client to the end of its recording (s), at rest and while moving.
AFTERMATH_S, LONGEST_AFTERMATH_S = 2.0, 10.0
MOVING = sample_block.Flag.RAMPING | sample_block.Flag.PLAYING | sample_block.Flag.TRACKING
MEGABYTE = 1e6
DESCRIPTION_TYPE = "piezo_interfaces/msg/StageDescription"


class Recorder(LifecycleNode):
    """Record topics as they arrive, undecoded, into rosbag2 directories."""

    def __init__(self) -> None:
        super().__init__("recorder")
        declare(self, "topics", ["samples", "feedback", "ground_truth", "applied_feedback",
                                 "reference", "controller/reference", "marks"],
                "Topics to record; the first of samples is the one that is counted.")
        declare(self, "types", [sample_block.TYPE_NAME, "piezo_interfaces/msg/FeedbackVoltage",
                                sample_block.TYPE_NAME, "piezo_interfaces/msg/AppliedFeedback",
                                "piezo_interfaces/msg/ReferenceSamples",
                                tracked_reference.TYPE_NAME, "piezo_interfaces/msg/Marks"],
                "Message types of the topics, in the same order.")
        declare(self, "minimum_free_mb", 200,
                "Free disk space (megabyte) below which a recording is refused or closed.",
                0, 1_000_000_000, read_only=False)
        self._data_root = declare_data_root(self)
        self._stage = DescribedStage(self, self._record_description)
        self._session: RecordingSession | None = None
        # Kept for clients that ask again because they missed the answer.
        self._started: StartRecording.Request | None = None
        self._stopped: tuple[StopRecording.Request, StopRecording.Response] | None = None
        self._client_gone_at: float | None = None
        self._last_block: bytes | None = None
        self._definitions: dict[str, MessageDefinition] = {}
        self._subscriptions_by_topic: dict[str, Subscription] = {}
        self._steady_clock = Clock(clock_type=ClockType.STEADY_TIME)
        self._housekeeping: list[Timer] = []
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        _create_waiting_service(
            self, StartRecording, "recorder/start_recording", self._start_recording)
        _create_waiting_service(
            self, StopRecording, "recorder/stop_recording", self._stop_recording)
        keep_clock(self, lambda: "a recording runs" if self._recording else "")
        autostart(self)

    # Lifecycle

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Look up the definitions of the message types."""
        topics = self.get_parameter("topics").value
        types = self.get_parameter("types").value
        if len(topics) != len(types):
            self.get_logger().error(
                f"Parameter topics names {len(topics)} topics, types {len(types)}: "
                "give one type for each topic.")
            return TransitionCallbackReturn.FAILURE
        if sample_block.TYPE_NAME not in types:
            self.get_logger().error(
                f"Parameter types has no {sample_block.TYPE_NAME}: record at least one of it.")
            return TransitionCallbackReturn.FAILURE
        try:
            self._definitions = {
                self.resolve_topic_name(topic): installed_definition(type_name)
                for topic, type_name in zip(topics, types, strict=True)}
            self._definitions[self._stage.topic] = installed_definition(DESCRIPTION_TYPE)
        except ValueError as error:
            self.get_logger().error(str(error))
            return TransitionCallbackReturn.FAILURE
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Subscribe to the topics."""
        # Subscribe now: a subscription made only when a recording starts could miss the first
        # samples.
        for topic, definition in self._definitions.items():
            if topic == self._stage.topic:  # published long ago, and stored
                continue
            self._subscriptions_by_topic[topic] = self.create_subscription(
                _message_class(definition.type_name), topic,
                functools.partial(self._receive, topic), SAMPLES, raw=True)
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Close the recording in progress, and unsubscribe."""
        self.close()
        for subscription in self._subscriptions_by_topic.values():
            self.destroy_subscription(subscription)
        self._subscriptions_by_topic = {}
        return super().on_deactivate(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Close the recording in progress, from any state."""
        self.close()
        return TransitionCallbackReturn.SUCCESS

    def close(self) -> None:
        """Close the recording in progress, if any."""
        if self._recording:
            self._end("the recorder was stopped")

    # Services

    async def _start_recording(self, request: StartRecording.Request,
                               response: StartRecording.Response) -> StartRecording.Response:
        self._stopped = None
        refusal = self._refusal(request)
        if not refusal and not await self._stage_is_there():
            refusal = (f"Nobody publishes {self._samples_topic}: "
                       "start the stage, or set the parameter topics.")
        refusal = refusal or await self._why_undescribed()
        # Checked again, as another request may have come while this one waited.
        refusal = refusal or self._refusal(request)
        recording = self._recording
        if recording and asks_the_same(request, self._started) and request.client:
            response.success, response.path = True, recording.path
            return response
        attachments, response.unread_attachments, unread = read_attachments(
            request, self._data_root.readable)
        refusal = refusal or unread
        if not refusal:
            try:
                session = self._session = self._new_session(request, attachments)
                self._started = request
            except OSError as error:
                refusal = f"{_sentence(error)}; name another directory"
            except DataRootError as error:
                refusal = str(error)
        if refusal:
            self.get_logger().error(refusal)
            response.message = refusal
            return response
        self._start_housekeeping()
        self.get_logger().info(f"Recording into {session.path}")
        response.success = True
        response.path = session.path
        return response

    def _refusal(self, request: StartRecording.Request) -> str:
        """Return why a recording cannot start now; empty if it can."""
        if late := why_too_late(request):
            return f"start_recording refused: {late}"
        if not self._subscriptions_by_topic:
            return "The recorder is not active: activate it first."
        if self._recording:
            return f"{self._recording.path} is being recorded: stop it first."
        count = len(request.attachment_names)
        for what, given, is_optional in (
                ("contents", request.attachment_contents, False),
                ("paths", request.attachment_paths, True),
                ("hashes", request.attachment_sha256, True)):
            if len(given) != count and (given or not is_optional):
                return (f"{count} attachment names were given with {len(given)} {what}: "
                        "give one for each.")
        try:
            path = self._path(request)
        except DataRootError as error:
            return str(error)
        free_mb = _free_mb(path)
        if free_mb < self._minimum_free_mb:
            return (f"Only {free_mb:.0f} MB are free in {path.parent}: "
                    f"make room for {self._minimum_free_mb} MB.")
        return ""

    def _path(self, request: StartRecording.Request) -> Path:
        """Return the path of the recording; raise DataRootError if a path is not allowed."""
        check_file_name(request.name, "a recording")
        for name in request.attachment_names:
            check_file_name(name, "an attachment")
        return self._data_root.writable(request.directory) / request.name

    async def _stage_is_there(self) -> bool:
        samples = self._subscriptions_by_topic[self._samples_topic]
        return await self._until(
            lambda: samples.get_publisher_count() > 0, DISCOVERY_TIMEOUT_S)

    async def _why_undescribed(self) -> str:
        """Return why the clock of the samples is unknown; empty if it is known."""
        if not await self._until(
                lambda: self._stage.description is not None, DISCOVERY_TIMEOUT_S):
            return f"Nobody describes the stage on {self._stage.topic}: configure the stage."
        return self._stage.contradiction

    def _new_session(self, request: StartRecording.Request,
                     attachments: Mapping[str, bytes]) -> RecordingSession:
        described = self._stage.description
        if described is None:  # withdrawn since the check
            raise OSError(f"Nobody describes the stage on {self._stage.topic} any more: "
                          "start the stage.")
        sample_rate_hz = described.sample_rate_hz
        writer = RecordingWriter(self._path(request), sample_rate_hz)
        session = RecordingSession(
            writer, self._definitions, sample_rate_hz, max(1, len(described.axes)),
            Presence(self, request.client),
            {topic: [offered_profile(publisher.qos_profile)
                     for publisher in self.get_publishers_info_by_topic(topic)]
             for topic in self._definitions})
        self._client_gone_at = self._last_block = None
        for name, content in attachments.items():
            writer.attach(name, content)
        session.receive(self._stage.topic, serialize_message(described),
                        self.get_clock().now().nanoseconds)
        return session

    async def _stop_recording(self, request: StopRecording.Request,
                              response: StopRecording.Response) -> StopRecording.Response:
        session = self._session
        if session is None:
            if self._stopped and asks_the_same(request, self._stopped[0]):
                return self._stopped[1]
            response.message = "Nothing is being recorded: start a recording first."
            return response
        owner = session.client.name
        if not session.closed and owner and request.client != owner:
            response.message = (f"{session.path} is recorded for {owner}: only that node stops "
                                "it, or give its name in client.")
            self.get_logger().warning(response.message)
            return response
        late = 0
        if request.last_sample:
            await self._until(
                lambda: session.closed or not session.missing_until(request.last_sample),
                ARRIVAL_TIMEOUT_S, lambda: session.missing_until(request.last_sample))
            late = session.missing_until(request.last_sample)
            await self._until(lambda: session.closed or session.quiet, QUIET_TIMEOUT_S)
        if not session.closed:
            self._end()
        if self._session is session:
            self._session = None
        if session.ended_early:
            response.message = f"The recording was closed early: {session.ended_early}."
        elif late:
            response.message = (f"{late} samples up to {request.last_sample} had not arrived, "
                                f"and none arrived for {ARRIVAL_TIMEOUT_S:g} s; the recording ends "
                                "before them.")
        response.success = not response.message
        response.path = session.path
        response.samples = session.samples
        response.missing_samples = session.missing + late
        self._stopped = request, response
        return response

    async def _until(self, condition: Callable[[], bool], timeout_s: float,
                     progress: Callable[[], object] = lambda: None) -> bool:
        """Wait until a condition holds or there is no progress; return whether it holds."""
        future = Future()
        patience = Patience(timeout_s)

        def check() -> None:
            if condition() or patience.ended(progress()):
                future.set_result(None)

        if not condition():
            timer = self.create_timer(POLL_PERIOD_S, check, clock=self._steady_clock)
            await future
            self.destroy_timer(timer)
        return condition()

    # Recording

    @property
    def _recording(self) -> RecordingSession | None:
        """The recording in progress; None if there is none."""
        session = self._session
        return session if session is not None and not session.closed else None

    @property
    def _samples_topic(self) -> str:
        return next(topic for topic, definition in self._definitions.items()
                    if definition.type_name == sample_block.TYPE_NAME)

    @property
    def _minimum_free_mb(self) -> int:
        return self.get_parameter("minimum_free_mb").value

    def _receive(self, topic: str, data: bytes) -> None:
        session = self._recording
        if session is None:
            return
        if topic == self._samples_topic:
            self._last_block = data
        try:
            session.receive(topic, data, self.get_clock().now().nanoseconds)
        except OSError as error:
            self._end(_sentence(error))

    def _record_description(self, description: StageDescription) -> None:
        """Record the description of a stage that is configured or restarted meanwhile."""
        if self._recording:
            self._receive(self._stage.topic, serialize_message(description))

    def _start_housekeeping(self) -> None:
        self._housekeeping = [
            self.create_timer(FLUSH_PERIOD_S, self._flush, clock=self._steady_clock),
            self.create_timer(DIAGNOSTICS_PERIOD_S, self._publish_diagnostics,
                              clock=self._steady_clock)]

    def _client_is_gone(self, session: RecordingSession) -> bool:
        """Return whether the recording's client has gone, and the stage has come to rest since."""
        if self._client_gone_at is None and session.client.gone:
            self._client_gone_at = time.monotonic()
        if self._client_gone_at is None:
            return False
        gone_s = time.monotonic() - self._client_gone_at
        return gone_s > (LONGEST_AFTERMATH_S if self._moves() else AFTERMATH_S)

    def _moves(self) -> bool:
        """Return whether the stage moved in the last block that was received."""
        block = self._last_block
        return block is not None and bool(deserialize_message(block, SampleBlock).flags & MOVING)

    def _flush(self) -> None:
        session = self._recording
        if session is None:  # ended after this callback was due
            return
        if self._client_is_gone(session):
            self._end(f"its client {session.client.name} is gone")
            return
        free_mb = _free_mb(session.writer.path)
        if free_mb < self._minimum_free_mb:
            self._end(f"only {free_mb:.0f} MB were free on the disk")
            return
        try:
            session.writer.flush()
        except OSError as error:
            self._end(_sentence(error))

    def _end(self, ended_early: str = "") -> None:
        session = self._session
        assert session is not None  # a recording has begun
        session.ended_early = ended_early
        for timer in self._housekeeping:
            self.destroy_timer(timer)
        try:
            session.close()
        except OSError as error:
            session.ended_early = ended_early or _sentence(error)
        if session.ended_early:
            self.get_logger().error(f"{session.path} was closed early: {session.ended_early}.")
        else:
            self.get_logger().info(f"Recorded {session.samples} samples into {session.path}")
        self._publish_diagnostics()

    def _publish_diagnostics(self) -> None:
        session = self._session
        if session is None:  # as above
            return
        if session.ended_early:
            level, message = DiagnosticStatus.ERROR, f"closed early: {session.ended_early}"
        elif session.missing:
            level, message = DiagnosticStatus.WARN, f"{session.missing} samples missing"
        else:
            level, message = DiagnosticStatus.OK, "closed" if session.closed else "recording"
        self._diagnostics.publish(diagnostic(self, "recording", level, message, {
            "path": session.path,
            "messages": session.writer.message_count,
            "samples": session.samples,
            "missing_samples": session.missing,
            "free_mb": round(_free_mb(session.writer.path)),
        }))


def _message_class(type_name: str) -> type:
    package, _, name = type_name.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), name)


def _free_mb(path: Path) -> float:
    path = path.absolute()
    existing = next(folder for folder in (path, *path.parents) if folder.exists())
    return shutil.disk_usage(existing).free / MEGABYTE


def _sentence(error: OSError) -> str:
    """Return the text of an OSError without its number."""
    if error.strerror is None:
        return str(error)
    return f"{error.strerror}: {error.filename}" if error.filename else error.strerror


def _create_waiting_service(
        node: Node, service_type: type, name: str,
        callback: Callable[[Any, Any], Coroutine[None, None, Any]]) -> None:
    """Create a service whose callback, a coroutine, takes request and response."""
    def begin(request: Any, late: LateResponse) -> None:
        async def answer() -> None:
            late.response = await callback(request, late.response)
            late.give()

        executor = node.executor
        if executor is not None:  # otherwise the node has ended without waiting any longer
            executor.create_task(answer)

    create_late_service(node, service_type, name, begin)


def main(args: list[str] | None = None) -> None:
    """Run the node ``recorder``."""
    run_node(Recorder, args)
