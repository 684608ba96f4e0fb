# SPDX-License-Identifier: BSD-3-Clause
"""Run the stage over a model and the controller in one process with one executor."""

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.experimental import EventsExecutor
from stage_model import ModelStage

from piezo_controller.node.controller_node import ControllerNode
from piezo_stage_driver.node.stage_node import StageNode


def main():
    """Run both nodes until SIGINT."""
    rclpy.init()
    stage = StageNode(lambda node: ModelStage())
    executor = EventsExecutor()
    executor.add_node(stage)
    executor.add_node(ControllerNode())
    try:
        while rclpy.ok():
            executor.spin_once(timeout_sec=stage.step())
    except (KeyboardInterrupt, ExternalShutdownException):
        pass


if __name__ == "__main__":
    main()
