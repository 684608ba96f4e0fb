# SPDX-License-Identifier: BSD-3-Clause
"""Start the suite's nodes as forks of one process that has imported their libraries once."""

import gc
import multiprocessing
import os
import subprocess
import sys
from collections.abc import Callable, Mapping
from functools import cache
from importlib.metadata import distribution
from multiprocessing.context import ForkServerContext
from multiprocessing.process import BaseProcess
from pathlib import Path

from piezo_bringup.processes import EXECUTABLES, NodeProcess, Processes


class ForkedProcesses(Processes):
    """As `Processes`, without the seconds that every node takes to import its libraries.

    A node runs what its executable runs, as a process of its own. Its end differs: a fork leaves
    without what the interpreter does at its end.
    """

    def _launch(self, name: str, command: list[str]) -> NodeProcess:
        process = _server().Process(
            target=_run, args=(name, command, self.log(name), self._environment), name=name)
        process.start()
        return ForkedNode(process)


class ForkedNode:
    """Fork that can be asked as a `NodeProcess`.

    Parameters
    ----------
    process : multiprocessing.Process
        One that has been started.
    """

    def __init__(self, process: BaseProcess) -> None:
        self._process = process

    @property
    def pid(self) -> int:
        """Return the number of the process."""
        assert self._process.pid is not None  # it has been started
        return self._process.pid

    @property
    def returncode(self) -> int | None:
        """Return the exit status; negative after a signal, None while the process runs."""
        return self._process.exitcode

    def poll(self) -> int | None:
        """Return the exit status, None while the process runs."""
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """Wait for the end.

        Raises
        ------
        subprocess.TimeoutExpired
            If the process still runs after the timeout (s).
        """
        self._process.join(timeout)
        status = self.returncode
        if status is None:
            raise subprocess.TimeoutExpired(self._process.name, timeout or 0.0)
        return status

    def send_signal(self, number: int, /) -> None:
        """Send a signal, unless the process has ended."""
        if self.returncode is None:
            os.kill(self.pid, number)

    def kill(self) -> None:
        """End the process at once."""
        self._process.kill()


@cache
def _server() -> ForkServerContext:
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([
        *(_entry(name).__module__ for name in EXECUTABLES), f"{__package__}.loaded_kernels"])
    return context


def _entry(name: str) -> Callable[[], None]:
    """Return what the executable of a node calls; it is called after the module that it runs."""
    package, executable = EXECUTABLES[name]
    entry, = distribution(package).entry_points.select(
        group="console_scripts", name=executable)
    main: Callable[[], None] = entry.load()
    return main


def _run(name: str, command: list[str], log: Path, environment: Mapping[str, str]) -> None:
    gc.freeze()  # to look through the libraries would copy all of them
    os.setsid()
    file = os.open(log, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
    for stream in sys.stdout, sys.stderr:
        os.dup2(file, stream.fileno())
    os.environ.clear()
    os.environ.update(environment)
    sys.argv = command
    _entry(name)()
