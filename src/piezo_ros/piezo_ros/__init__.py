# SPDX-License-Identifier: BSD-3-Clause
"""What the node modules share: spinning, parameters, action helpers."""
