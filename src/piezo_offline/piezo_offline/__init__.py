# SPDX-License-Identifier: BSD-3-Clause
"""The offline commands under one name, for people with and without ROS."""
