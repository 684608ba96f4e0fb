# SPDX-License-Identifier: BSD-3-Clause
"""The stage as a ROS node."""
