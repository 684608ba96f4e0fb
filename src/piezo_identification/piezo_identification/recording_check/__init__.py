# SPDX-License-Identifier: BSD-3-Clause
"""What a recording is good for, before anything is fitted to it."""
