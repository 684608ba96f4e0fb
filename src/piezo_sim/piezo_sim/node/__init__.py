# SPDX-License-Identifier: BSD-3-Clause
"""The simulated stage as a ROS node."""
