# SPDX-License-Identifier: BSD-3-Clause
"""Track a raster of ten lines, given sample by sample. The stage's nodes must run.

    python examples/track_any_trajectory.py runs/example/model.json runs/example
"""

import sys
from pathlib import Path

import numpy as np
from rclpy.utilities import remove_ros_args

from piezo_client.references import sampled
from piezo_client.stage import Stage

model, directory = remove_ros_args(sys.argv)[1:]

# Ten smooth steps of 2 um up and ten down, 10 ms each.
steps = np.concatenate([np.arange(10), np.arange(10, 0, -1)])
way = (1.0 - np.cos(np.linspace(0.0, np.pi, 400, endpoint=False))) / 2.0
direction = np.repeat([1.0, -1.0], 10)
displacement_um = 40.0 + 2.0 * (steps[:, None] + direction[:, None] * way).ravel()

with Stage() as stage:
    reference = sampled(displacement_um, Path(directory, "raster.csv"))
    for mode in ("feedforward", "composite"):
        run = stage.track(reference, model, mode, duration_s=0.4, directory=directory)
        print(f"{mode}: e_rms {run.e_rms_percent:.3f} %, largest {run.largest_error_um:.3f} um")
