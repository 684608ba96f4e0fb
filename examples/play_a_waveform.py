# SPDX-License-Identifier: BSD-3-Clause
"""Play a voltage of your own and look at the response. The stage and the recorder must run.

    python examples/play_a_waveform.py runs/example
"""

import sys

import numpy as np
from rclpy.utilities import remove_ros_args

from piezo_client.stage import Stage

directory, = remove_ros_args(sys.argv)[1:]
time_s = 25e-6 * np.arange(4000)
voltage_v = 30.0 * (1.0 - np.cos(2.0 * np.pi * 100.0 * time_s))

with Stage() as stage:
    recording = stage.play(voltage_v, directory=directory, name="cosine").recording()

played = recording.select(recording.playing)
print(f"{len(played.time_s)} samples, {np.ptp(played.displacement_um):.2f} um peak to peak "
      f"for {np.ptp(played.voltage_v):.0f} V")
