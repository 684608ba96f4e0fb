# SPDX-License-Identifier: BSD-3-Clause
"""Start the suite's nodes as forks of one process that has already imported their libraries."""

import gc
import multiprocessing
import os
import subprocess
import sys
from collections.abc import Callable, Iterable, Mapping
from functools import cache, partial
from importlib.metadata import distribution
from multiprocessing.context import ForkServerContext
from multiprocessing.forkserver import ensure_running
from multiprocessing.process import BaseProcess
from pathlib import Path
from unittest import mock

from short_work import work_shortly

from piezo_bringup.processes import EXECUTABLES, NodeProcess, Processes


class ForkedProcesses(Processes):
    """Like `Processes`, but without the seconds in which every node imports its libraries.

    A node runs the code of its executable in a separate process, but draws nothing, searches
    briefly and runs its fits one after the other. A fork ends without the usual shutdown of the
    interpreter.
    """

    def start_main(self, name: str, main: Callable[[], object], arguments: Iterable[str]) -> None:
        """Start a node that is none of `EXECUTABLES`.

        Parameters
        ----------
        main : callable
            Function of a module that processes of this one's ``sys.path`` can import; called with
            the arguments in ``sys.argv``.
        """
        self._running[name] = self._fork(name, main, [name, *arguments])

    def _launch(self, name: str, command: list[str]) -> NodeProcess:
        return self._fork(name, partial(_run_executable, name), command)

    def _fork(self, name: str, main: Callable[[], object], command: list[str]) -> NodeProcess:
        process = _server().Process(
            target=_run, args=(main, command, self.log(name), self._environment), name=name)
        process.start()
        return ForkedNode(process)


class ForkedNode:
    """A forked process with the interface of `NodeProcess`."""

    def __init__(self, process: BaseProcess) -> None:
        self._process = process

    @property
    def pid(self) -> int:
        """Return the process ID."""
        assert self._process.pid is not None  # it has been started
        return self._process.pid

    @property
    def returncode(self) -> int | None:
        """Return the exit status; negative after a signal, None while the process runs."""
        return self._process.exitcode

    def poll(self) -> int | None:
        """Return the exit status; None while the process runs."""
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
        *(_entry(name).__module__ for name in EXECUTABLES), "started_before",
        work_shortly.__module__, "rosidl_generator_py"])  # by which a node imports its messages
    # Python 3.11 seeks them without this process's sys.path, and passes over what it does not find.
    with mock.patch.dict(os.environ, PYTHONPATH=os.pathsep.join(sys.path)):
        ensure_running()
    return context


def _entry(name: str) -> Callable[[], None]:
    """Return the entry point of the executable of a node."""
    package, executable = EXECUTABLES[name]
    entry, = distribution(package).entry_points.select(
        group="console_scripts", name=executable)
    main: Callable[[], None] = entry.load()
    return main


def _run_executable(name: str) -> None:
    _entry(name)()


def _run(main: Callable[[], object], command: list[str], log: Path,
         environment: Mapping[str, str]) -> None:
    gc.freeze()  # garbage collection would copy the memory of all libraries
    os.setsid()
    file = os.open(log, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
    for stream in sys.stdout, sys.stderr:
        os.dup2(file, stream.fileno())
    os.environ.clear()
    os.environ.update(environment)
    sys.argv = command
    assert "started_before" in sys.modules, "the fork server did not find what nodes start with"
    work_shortly()
    main()
