# SPDX-License-Identifier: BSD-3-Clause
"""Recording of stage samples as rosbag2 MCAP, and the reader of recordings."""
