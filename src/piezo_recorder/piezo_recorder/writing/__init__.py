# SPDX-License-Identifier: BSD-3-Clause
"""Writers of recordings as rosbag2 directories with one MCAP file."""
