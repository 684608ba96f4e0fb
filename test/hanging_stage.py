# SPDX-License-Identifier: BSD-3-Clause
"""A stage that hangs at 50 V until a file is there, which the first argument names."""

import sys
import time
from pathlib import Path

import numpy as np

from piezo_ros.spinning import run_node
from piezo_stage_driver.node.stage_node import StageNode


class Hanging:
    """A backend that touches another file once it hangs."""

    sample_rate_hz = 40000.0

    def open(self):
        self.due_s = time.monotonic()

    def exchange(self, voltage_v):
        while voltage_v[-1] >= 50.0 and not Path(sys.argv[1]).exists():
            Path(sys.argv[1] + ".awaited").touch()
            time.sleep(0.005)
        self.due_s = max(self.due_s, time.monotonic() - 0.1) + len(voltage_v) / 40000.0
        time.sleep(max(0.0, self.due_s - time.monotonic()))
        return voltage_v + 1e-3 * np.sin(np.arange(len(voltage_v)))

    def close(self):
        pass


class WithOwnRest(Hanging):
    """A backend that also has its own way to rest."""

    def emergency_rest(self):
        pass


def main(backend=Hanging):
    run_node(lambda: StageNode(lambda node: backend()), sys.argv)


def own_rest():
    main(WithOwnRest)


if __name__ == "__main__":
    main()
