# SPDX-License-Identifier: BSD-3-Clause
"""The stand-in for a card lies beside the tests."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
