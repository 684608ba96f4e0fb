# SPDX-License-Identifier: BSD-3-Clause
"""Images from recordings of scans."""
