# SPDX-License-Identifier: BSD-3-Clause
"""Launch files, parameters and the demo of the piezo stage packages."""
