# SPDX-License-Identifier: BSD-3-Clause
"""Recording of a run by the recorder node."""

import hashlib
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import chain, count
from os import PathLike
from pathlib import Path
from types import TracebackType

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from piezo_interfaces.srv import StartRecording, StopRecording
from rclpy.node import Node

from piezo_ros.presence import Presence
from piezo_ros.quality import DIAGNOSTICS_DEPTH
from piezo_ros.requests.calls import CallFailed, NoAnswer, Refused, call_service

# The recorder itself waits for outstanding samples while they keep arriving.
STOP_TIMEOUT_S = 120.0
STOP_APPEARANCE_S = 1.0


class RunRecording:
    """The recording of one run; a context manager that closes it when the run is over.

    A run ends if its recording ends early, unless it may continue unrecorded. `stop` closes the
    recording: it is called with the last sample that it must contain, `last_sample`, or 0 to close
    it as it is, and returns the recorder's response. Without it, the client that started the
    recording must close it.
    """

    def __init__(self, path: str, recorder: Presence, unrecorded: bool,
                 stop: Callable[[int], StopRecording.Response] | None) -> None:
        self.path = path
        self.last_sample = 0
        self._recorder, self._unrecorded, self._stop = recorder, unrecorded, stop
        self._failure = self._note = ""
        self._over = False

    @property
    def failure(self) -> str:
        """Return why the recording ended before the run; empty if it did not."""
        if not (self._failure or self._over) and self._recorder.gone:
            self._failure = (f"the recorder {self._recorder.name} is gone: start it again; what "
                             f"it had recorded is in {self.path}")
        return self._failure

    @property
    def must_stop(self) -> bool:
        """Return True if the run must end because its recording has ended."""
        return bool(self.failure) and not self._unrecorded

    @property
    def note(self) -> str:
        """Return a remark on the recording of a completed run; empty if there is none."""
        if self._failure:
            return f"the run went on unrecorded: {self._failure}"
        return self._note

    def ended(self, path: str, message: str) -> None:
        """Process the report that the recorder closed the recording of a path early."""
        if path == self.path:
            self._failure = self._failure or f"{path} was {message}"

    def __enter__(self) -> "RunRecording":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 traceback: TracebackType | None) -> None:
        if self._stop and not self.failure:
            self._close(self._stop)
        self._over = True
        if self._failure and isinstance(error, ValueError):
            raise CallFailed(f"{error}; {self._failure}") from error
        if error is None and self.must_stop:
            raise CallFailed(self._failure)

    def _close(self, stop: Callable[[int], StopRecording.Response]) -> None:
        try:
            missing_samples = stop(self.last_sample).missing_samples
        except CallFailed as error:
            self._failure = self.failure or str(error)
        else:
            if missing_samples:
                self._note = f"{missing_samples} samples are missing in the recording"


class RecorderNews:
    """Reports of the recorder in a node's namespace on one recording after the other."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._recording: RunRecording | None = None
        self._recorder = f"{node.get_namespace().rstrip('/')}/recorder"
        node.create_subscription(
            DiagnosticArray, "/diagnostics", self._on_diagnostics, DIAGNOSTICS_DEPTH)

    def about(self, path: str, unrecorded: bool = False,
              stop: Callable[[int], StopRecording.Response] | None = None) -> RunRecording:
        """Return the `RunRecording` of a path, which receives reports from now on."""
        self._recording = RunRecording(
            path, Presence(self._node, self._recorder), unrecorded, stop)
        return self._recording

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if (self._recording and status.level == DiagnosticStatus.ERROR
                    and status.name == f"{self._recorder}: recording"):
                values = {value.key: value.value for value in status.values}
                self._recording.ended(values.get("path", ""), status.message)


@dataclass(frozen=True)
class Attachment:
    """A text to be stored in a recording."""

    text: str

    path: str = ""
    """Path of a file with the text, if there is one; the recorder then reads it there."""

    @property
    def sha256(self) -> str:
        """Return the hash of the text."""
        return hashlib.sha256(self.text.encode()).hexdigest()


class RecorderCaller:
    """Request recordings of runs, one at a time."""

    def __init__(self, node: Node) -> None:
        self._node, self._news = node, RecorderNews(node)
        self._client = node.get_fully_qualified_name()
        self._start = node.create_client(StartRecording, "recorder/start_recording")
        self._stop = node.create_client(StopRecording, "recorder/stop_recording")

    def record(self, directory: str | PathLike[str], name: str,
               attachments: Mapping[str, Attachment], unrecorded: bool = False) -> RunRecording:
        """Start a recording under a name that is not used yet.

        A number is added to the name if a recording has that name. The texts are stored in the
        recording, by name. If `unrecorded`, the run may continue after its recording has ended.
        Raises `CallFailed` if the recorder cannot start the recording.
        """
        request = StartRecording.Request(
            directory=str(Path(directory).absolute()), name=free_name(directory, name),
            attachment_names=list(attachments),
            attachment_contents=["" if one.path else one.text for one in attachments.values()],
            attachment_paths=[one.path for one in attachments.values()],
            attachment_sha256=[one.sha256 for one in attachments.values()], client=self._client)
        try:
            path = call_service(self._node, self._start, request).path
        except Refused as refused:
            unread = refused.response.unread_attachments
            if not unread:
                raise
            # The file is on another machine, or has changed: send the text that was read and used.
            return self.record(directory, name, {
                name: Attachment(one.text) if name in unread else one
                for name, one in attachments.items()}, unrecorded)
        except NoAnswer:
            # The recording may have started nevertheless, and would block those of other clients.
            self._stop.call_async(StopRecording.Request(client=self._client))
            raise
        return self._news.about(path, unrecorded, self._close)

    def _close(self, last_sample: int) -> StopRecording.Response:
        request = StopRecording.Request(last_sample=last_sample, client=self._client)
        return call_service(self._node, self._stop, request, STOP_TIMEOUT_S, STOP_APPEARANCE_S)


def free_name(directory: str | PathLike[str], name: str) -> str:
    """Return the name, or the first of name_2, name_3 ... that is not used in the directory."""
    try:
        taken = set(os.listdir(directory))
    except OSError:  # no directory yet; the recorder reports any other problem
        taken = set()
    numbered = (f"{name}_{number}" for number in count(2))
    return next(candidate for candidate in chain([name], numbered) if candidate not in taken)
