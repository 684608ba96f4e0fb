# SPDX-License-Identifier: BSD-3-Clause
"""Start the suite's nodes as processes, and end them in order."""

import os
import signal
import subprocess
from collections.abc import Iterable, Mapping
from os import PathLike
from pathlib import Path
from typing import Protocol, Self

from ament_index_python.packages import get_package_prefix

STOP_TIMEOUT_S = 15.0

EXECUTABLES = {
    "stage": ("piezo_sim", "stage_sim"),
    "recorder": ("piezo_recorder", "recorder"),
    "identification": ("piezo_identification", "identification"),
    "controller": ("piezo_controller", "controller"),
    "monitor": ("piezo_identification", "monitor"),
}

USUAL_NODES = ("stage", "recorder", "identification", "controller")
"""Those of `EXECUTABLES` that are started by default."""


class NodeProcess(Protocol):
    """Interface of a node's process, a subset of ``subprocess.Popen``."""

    @property
    def pid(self) -> int:
        """Return the process ID."""

    @property
    def returncode(self) -> int | None:
        """Return the last known exit status; negative after a signal."""

    def poll(self) -> int | None:
        """Return the exit status, None while the process runs."""

    def wait(self, timeout: float | None = None) -> int:
        """Wait for the end; raise ``subprocess.TimeoutExpired`` after the timeout in s."""

    def send_signal(self, number: int, /) -> None:
        """Send a signal, unless the process has ended."""

    def kill(self) -> None:
        """End the process at once."""


class Processes:
    """Nodes as separate processes; a context manager that ends them.

    Parameters
    ----------
    log_directory : path-like
        Folder for one log file per process.
    environment : dict of str to str, optional
        Additional environment variables, for example ``ROS_DOMAIN_ID``.
    data_root : path-like, optional
        Folder under which the nodes write; by default this process' working directory, or that of
        a parameter file.
    """

    def __init__(self, log_directory: str | PathLike[str],
                 environment: Mapping[str, str] | None = None,
                 data_root: str | PathLike[str] | None = None) -> None:
        self._log_directory = Path(log_directory)
        self._log_directory.mkdir(parents=True, exist_ok=True)
        self._parameters = {} if data_root is None else {"data_root": Path(data_root).absolute()}
        self._environment = {**os.environ, **(environment or {})}
        # The wheels' guard applies to this process; a child must find its libraries itself.
        self._environment.pop("_ROS_WHEELS_BOOTSTRAP_COMPLETE", None)
        self._running: dict[str, NodeProcess] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def start(self, name: str, parameters: Mapping[str, object] | None = None,
              namespace: str | None = None,
              parameter_file: str | PathLike[str] | None = None) -> None:
        """Start one of `EXECUTABLES`.

        Parameters
        ----------
        parameter_file : path-like, optional
            YAML file of ROS parameters.
        """
        package, executable = EXECUTABLES[name]
        command = [str(Path(get_package_prefix(package), "lib", package, executable)),
                   "--ros-args"]
        for key, value in {**self._parameters, **(parameters or {})}.items():
            text = str(value).lower() if isinstance(value, bool) else value
            command += ["-p", f"{key}:={text}"]
        if namespace:
            command += ["-r", f"__ns:={namespace}"]
        if parameter_file:
            command += ["--params-file", str(parameter_file)]
        self._running[name] = self._launch(name, command)

    def _launch(self, name: str, command: list[str]) -> NodeProcess:
        with open(self.log(name), "a", encoding="utf-8") as log:
            # In its own session, Ctrl-C reaches only this process, which ends the others in order.
            return subprocess.Popen(
                command, stdout=log, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL,
                env=self._environment, start_new_session=True)

    def log(self, name: str) -> Path:
        """Return the path of the log file of a process."""
        return self._log_directory / f"{name}.log"

    def process(self, name: str) -> NodeProcess:
        """Return the process of a node."""
        return self._running[name]

    def stop(self, names: Iterable[str] | None = None) -> None:
        """End processes by SIGINT, the last started first; kill those that do not end."""
        for name in reversed(list(names or self._running)):
            process = self._running.pop(name)
            process.send_signal(signal.SIGINT)
            try:
                process.wait(STOP_TIMEOUT_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
