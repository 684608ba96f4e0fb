# SPDX-License-Identifier: BSD-3-Clause
"""Study of feedback at the sample rate with a bandwidth beyond the first mode."""
