# SPDX-License-Identifier: BSD-3-Clause
"""Checks and evaluation of a feedback law from samples, without its design and without ROS."""
