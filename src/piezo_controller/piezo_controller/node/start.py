# SPDX-License-Identifier: BSD-3-Clause
"""Start the node of this package; Ctrl-C is handled before anything else is imported."""

from piezo_ros.starting import node_entry

main = node_entry(
    "piezo_controller.node.controller_node",
    "Track references with the stage: feedforward and feedback for a model.")
