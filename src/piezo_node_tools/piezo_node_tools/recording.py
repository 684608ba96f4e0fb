# SPDX-License-Identifier: BSD-3-Clause
"""Have a run recorded by the recorder node."""

import os
from itertools import chain, count
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from piezo_interfaces.srv import StartRecording, StopRecording

from piezo_node_tools.calls import call_service

STOP_TIMEOUT_S = 60.0


class RecorderCaller:
    """Start and stop recordings.

    Parameters
    ----------
    node : rclpy.node.Node

    Attributes
    ----------
    closed_early : bool
        Whether the recorder had to close the last recording, as where the disk is full.
    """

    def __init__(self, node):
        self.closed_early = False
        self._status_name = f"{node.get_namespace().rstrip('/')}/recorder: recording"
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)
        self._client = node.get_fully_qualified_name()
        self._start = node.create_client(StartRecording, "recorder/start_recording")
        self._stop = node.create_client(StopRecording, "recorder/stop_recording")

    def start(self, directory, name, attachments):
        """Start a recording under a name that is not taken yet.

        Parameters
        ----------
        directory, name : str
            A number is added to the name where a recording of that name exists.
        attachments : dict of str to str
            Files to be kept inside the recording.

        Returns
        -------
        path : str

        Raises
        ------
        CallFailed
        """
        self.closed_early = False
        return call_service(self._start, StartRecording.Request(
            directory=str(Path(directory).absolute()), name=free_name(directory, name),
            attachment_names=list(attachments),
            attachment_contents=list(attachments.values()), client=self._client)).path

    def stop(self, last_sample=0):
        """Close the recording once ``last_sample`` is in it.

        Raises
        ------
        CallFailed
            Also if samples are missing.
        """
        return call_service(
            self._stop, StopRecording.Request(last_sample=last_sample), STOP_TIMEOUT_S)

    def _on_diagnostics(self, message):
        for status in message.status:
            if status.name == self._status_name and status.level == DiagnosticStatus.ERROR:
                self.closed_early = True


def free_name(directory, name):
    """Return the name, or the first of name_2, name_3 ... that the directory does not hold yet."""
    try:
        taken = set(os.listdir(directory))
    except OSError:  # nothing there yet; else the recorder tells what is wrong
        taken = set()
    numbered = (f"{name}_{number}" for number in count(2))
    return next(candidate for candidate in chain([name], numbered) if candidate not in taken)
