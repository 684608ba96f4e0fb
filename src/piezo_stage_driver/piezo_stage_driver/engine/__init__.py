# SPDX-License-Identifier: BSD-3-Clause
"""Playing programs on the stage, sample by sample and tick by tick."""
