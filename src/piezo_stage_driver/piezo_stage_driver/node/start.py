# SPDX-License-Identifier: BSD-3-Clause
"""Start the node of this package; Ctrl-C is handled before anything else is imported."""

from piezo_ros.starting import node_entry

main = node_entry(
    "piezo_stage_driver.node.stage_node",
    "Run a stage behind a backend, such as a card with amplifier and sensor.")
