# SPDX-License-Identifier: BSD-3-Clause
"""Start the benchmarks' own nodes beside those of the suite."""

import subprocess
import sys
from pathlib import Path

from piezo_bringup.processes import Processes


class BenchmarkProcesses(Processes):
    """Starts the node modules of this directory as well."""

    def start_module(self, name, parameters=None):
        """Start a module of this directory, such as ``ping_node``, with ROS parameters."""
        module = Path(__file__).with_name(f"{name}.py")
        command = [sys.executable, str(module), "--ros-args"]
        for key, value in (parameters or {}).items():
            text = str(value).lower() if isinstance(value, bool) else value
            command += ["-p", f"{key}:={text}"]
        with open(self.log(name), "a", encoding="utf-8") as log:
            self._running[name] = subprocess.Popen(
                command, stdout=log, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL,
                env=self._environment, start_new_session=True)
