# SPDX-License-Identifier: BSD-3-Clause
"""A node is ended before the stage that was started beside it, whatever both have inherited."""

import subprocess
import sys

import pytest

PROGRAM = """
from pathlib import Path
from piezo_ros.memory_limit import end_before_stage
score = Path("/proc/self/oom_score_adj")
score.write_text("{inherited}")
end_before_stage()
print(score.read_text())
"""


@pytest.mark.parametrize("inherited", [500, 800])
def test_score_is_higher_than_what_a_stage_inherits(inherited):
    done = subprocess.run([sys.executable, "-c", PROGRAM.format(inherited=inherited)],
                          capture_output=True, text=True, check=True, timeout=300)
    assert int(done.stdout) > inherited
