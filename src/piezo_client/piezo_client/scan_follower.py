# SPDX-License-Identifier: BSD-3-Clause
"""Make the stage follow a path with the feedback that it evaluates by itself."""

import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

from piezo_client.client import CANCEL_TIMEOUT_S, WATCH_PERIOD_S, Client, ServiceFailed
from piezo_controller.axes.followed_scan import FollowedScan
from piezo_ros.messages import Message
from piezo_ros.requests.calls import CallFailed
from piezo_ros.stage_runs.law_message import message_of
from piezo_ros.stage_runs.stage_tracking import StageTracker

Progress = Callable[[str, float, float], object]


class ScanFollower:
    """Follow one path after the other, while the client's executor spins."""

    def __init__(self, client: Client) -> None:
        self._client, self._tracker = client, StageTracker(client.node)

    def follow(self, run: FollowedScan, why_stop: Callable[[], str],
               progress: Progress | None) -> int:
        """Follow a path; return the last sample of the run, with the return to rest.

        ``why_stop`` is called periodically; a text that is not empty ends the run, which fails with
        it. For the progress see `piezo_client.stage.Stage`. Raises `ServiceFailed` if the stage
        rejects the run, or stops before its end.
        """
        samples, cancelled = 0, threading.Event()

        def take(block: Message) -> float:
            nonlocal samples
            samples += len(block.displacement_um) // len(run.axes)
            if progress:
                left = 1.0 - samples / run.samples
                progress("", 1.0 - left, left * run.samples * block.sample_period_s)
            return 0.0

        with ThreadPoolExecutor(1) as pool:
            over = pool.submit(
                self._tracker.run, run.once_voltage_v, run.period_voltage_v, run.ticks, take,
                answering=False, cancelled=lambda: cancelled.is_set() or bool(why_stop()),
                report=lambda: None, law=None if run.law is None else message_of(run.law),
                axes=run.axes, marks=(b"", run.period_marks.tobytes()))
            try:
                self._wait(over)
                if cause := why_stop():
                    raise ServiceFailed(cause)
                if samples < run.samples:
                    ended = pool.submit(self._tracker.why_ended)
                    raise ServiceFailed(f"the stage stopped before the end: {self._wait(ended)}")
            except CallFailed as error:
                raise ServiceFailed(str(error)) from None
            except BaseException:  # such as Ctrl-C
                cancelled.set()
                self._client.spin_until(over.done, CANCEL_TIMEOUT_S)
                raise
        return self._tracker.last_sample

    def _wait(self, future: Future[Any]) -> Any:
        while not self._client.spin_until(future.done, WATCH_PERIOD_S):
            pass
        return future.result()
