# SPDX-License-Identifier: BSD-3-Clause
"""Stages of other makes, which share no mathematical form with the models, and their study."""
