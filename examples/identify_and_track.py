# SPDX-License-Identifier: BSD-3-Clause
"""Identify a stage and track a sine with its model. The stage's nodes must run.

    python examples/identify_and_track.py runs/example
"""

import sys

from rclpy.utilities import remove_ros_args

from piezo_client.references import harmonic
from piezo_client.stage import Stage
from piezo_common.progress_line import ProgressLine

directory, *recordings = remove_ros_args(sys.argv)[1:]

with Stage(progress=ProgressLine().show) as stage:
    identified = stage.identify(directory, recordings)
    stage.settle()
    run = stage.track(harmonic(100.0, 40.0, centre_um=50.0), identified, directory=directory)

print(f"\nerrors of the model: {identified.errors}")
print(f"e_rms {run.e_rms_percent:.3f} %, recorded in {run.path}")
