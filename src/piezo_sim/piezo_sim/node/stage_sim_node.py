# SPDX-License-Identifier: BSD-3-Clause
"""The stage node with the simulated stage, which also publishes the true displacement."""

import array
from typing import cast

import numpy as np
from piezo_interfaces.msg import SampleBlock
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.lifecycle.node import LifecycleState
from rclpy.publisher import Publisher

from piezo_common.arrays import FloatArray
from piezo_common.gsf import read_gsf
from piezo_ros.parameters import declare
from piezo_sim.paced import PacedStage
from piezo_sim.plant.plant_file import AxesPlantConfig, read_any_plant
from piezo_sim.simulated_stage import SimulatedStage
from piezo_stage_driver.backends.backend import StageBackend
from piezo_stage_driver.engine.blocks import Block
from piezo_stage_driver.node.stage_node import StageNode, run_stage

GROUND_TRUTH_SAMPLES = 4000


class SimulatedStageNode(StageNode):
    """Publish ``ground_truth`` in addition to ``samples``, except during a slow waveform."""

    def __init__(self) -> None:
        self._ground_truth: Publisher | None = None
        # True displacements, and the voltages of blocks, since the last message.
        self._true_um: list[FloatArray] = []
        self._voltage_v: list[FloatArray] = []
        self._truth_first_sample = 0
        super().__init__(create_simulated_stage)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Start sample clock and true displacement at sample 0."""
        self._ground_truth = self._ground_truth or self.create_publisher(
            SampleBlock, "ground_truth", self._outputs.quality)
        self._true_um, self._voltage_v, self._truth_first_sample = [], [], 0
        return super().on_activate(state)

    def take_truth(self, displacement_um: FloatArray) -> None:
        """Store the true displacement of an exchange."""
        self._true_um.append(displacement_um)

    def on_block(self, block: Block) -> None:
        """Publish the true displacement in large messages."""
        if block.sample_period_s > self._engine.sample_period_s:
            if self._voltage_v:
                self._publish_truth(block)
            self._true_um = []
            return
        if not self._voltage_v:
            self._truth_first_sample = block.first_sample
        self._voltage_v.append(block.voltage_v)
        samples = block.first_sample + len(block.voltage_v) - self._truth_first_sample
        is_last = self._engine.idle and not self._engine.holds_block and (
            self.settings.lockstep or not self._active)
        if samples >= GROUND_TRUTH_SAMPLES or is_last:
            self._publish_truth(block)

    def _publish_truth(self, block: Block) -> None:
        voltage_v = np.concatenate(self._voltage_v)
        displacement_um, later_um = np.split(np.concatenate(self._true_um), [len(voltage_v)])
        self._voltage_v, self._true_um = [], [later_um]
        message = SampleBlock(
            first_sample=self._truth_first_sample,
            sample_period_s=self._engine.sample_period_s,
            tick=block.tick, flags=block.flags, axes=self._outputs.axes,
            voltage_v=array.array("d", voltage_v.tobytes()),
            displacement_um=array.array("d", displacement_um.tobytes()))
        assert self._ground_truth is not None  # created when the stage was activated
        self._outputs.publish_samples(self._ground_truth, message)


def create_simulated_stage(node: SimulatedStageNode) -> StageBackend:
    """Return the backend that the node's parameters describe."""
    seed = declare(node, "seed", 1, "Seed of the sensor noise.", 0, 2**31 - 1)
    plant = declare(node, "plant", "", "Plant file (YAML), or the name of a plant that comes with "
                    "the simulator; empty for the default plant.")
    specimen = declare(node, "specimen", "", "Heights under the tip of a stage of several axes "
                       "(.gsf), for images; empty for none.")
    config = read_any_plant(plant or None)
    axes = tuple(config.axes) if isinstance(config, AxesPlantConfig) else ()
    stage = SimulatedStage(
        config, seed, node.settings.sample_rate_hz, node.settings.rest_v(axes),
        read_gsf(specimen) if specimen else None)
    stage.on_truth = node.take_truth
    # Neither has `lead_samples`, which is optional.
    return cast(StageBackend, stage if node.settings.lockstep else PacedStage(stage))


def main(args: list[str] | None = None) -> None:
    """Run the node ``stage`` with the simulated stage."""
    run_stage(SimulatedStageNode, args)
