# SPDX-License-Identifier: BSD-3-Clause
"""Linear dynamics of the stage: creep, electric lag and modes of vibration, and their inverse."""
