# SPDX-License-Identifier: BSD-3-Clause
"""The recordings of rasters lie beside the tests."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
