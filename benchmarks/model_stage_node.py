# SPDX-License-Identifier: BSD-3-Clause
"""Run the stage over a model, and keep how long every answer took."""

import array
import time

import numpy as np
from stage_model import ModelStage

from piezo_ros.parameters import declare
from piezo_ros.spinning import run_node
from piezo_stage_driver.node.stage_node import StageNode

SAMPLES_PER_TICK = 40


class TimedModelStage(ModelStage):
    """Keeps the pace of the wall clock if so asked, and when each tick was measured."""

    def __init__(self, paced):
        super().__init__()
        self._paced = paced
        self._due_s = time.perf_counter()
        self._samples = 0
        self.measured_at_s = {}

    def exchange(self, voltage_v):
        """Play voltages on the model in place of a plant."""
        displacement_um = super().exchange(voltage_v)
        self._due_s += len(voltage_v) / self.sample_rate_hz
        now_s = time.perf_counter()
        if self._paced and now_s < self._due_s:
            time.sleep(self._due_s - now_s)
        else:
            self._due_s = now_s
        self._samples += len(voltage_v)
        self.measured_at_s[self._samples // SAMPLES_PER_TICK] = time.perf_counter()
        return displacement_um


class ModelStageNode(StageNode):
    """Times each tick from its measurement until its answer is there."""

    def __init__(self):
        super().__init__(lambda node: TimedModelStage(not node.settings.lockstep))
        self._file = declare(self, "round_trips_file", "", "Where to write (npy); empty: nowhere.")
        self._round_trips_s = array.array("d")

    def _on_feedback(self, message):
        super()._on_feedback(message)
        measured_at_s = self._backend.measured_at_s[message.tick]
        self._round_trips_s.append(time.perf_counter() - measured_at_s)

    def close(self):
        """Write the round trips."""
        if self._file:
            np.save(self._file, np.array(self._round_trips_s))


if __name__ == "__main__":
    run_node(ModelStageNode)
