# SPDX-License-Identifier: BSD-3-Clause
"""Helpers for all node modules: spinning, parameters, services and actions."""
