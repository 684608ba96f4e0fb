# SPDX-License-Identifier: BSD-3-Clause
"""Start the node of this package; nothing else is imported before Ctrl-C is seen to."""

from piezo_ros.starting import node_entry

main = node_entry("piezo_recorder.node.recorder_node")
