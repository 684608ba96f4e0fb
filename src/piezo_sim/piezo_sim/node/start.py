# SPDX-License-Identifier: BSD-3-Clause
"""Start the node of this package; Ctrl-C is handled before anything else is imported."""

from piezo_ros.starting import node_entry

main = node_entry(
    "piezo_sim.node.stage_sim_node",
    "Run a stage node whose stage is simulated.")
