# SPDX-License-Identifier: BSD-3-Clause
"""Whether probabilities and intervals of a diagnosis come true: hundreds of short recordings."""
