# SPDX-License-Identifier: BSD-3-Clause
"""Start a node of this package; Ctrl-C is handled before anything else is imported."""

from piezo_ros.starting import node_entry

main = node_entry(
    "piezo_identification.node.identification_node",
    "Run experiments on the stage, identify models and diagnose them.")

monitor = node_entry(
    "piezo_identification.node.monitor_node",
    "Run a model in parallel with the tracking stage, and report when it no longer fits.")
