# SPDX-License-Identifier: BSD-3-Clause
"""What the stage plays, sample by sample and tick by tick."""
