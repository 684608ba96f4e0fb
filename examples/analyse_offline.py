# SPDX-License-Identifier: BSD-3-Clause
"""Open a recording and a model, without ROS: arrays, a pandas frame, python-control.

    python examples/analyse_offline.py runs/example/dynamics runs/example/model.json
"""

import sys

import control
import numpy as np

from piezo_models.control_objects import from_control, to_control
from piezo_models.model_file import load_model
from piezo_recorder.reading.frames import read_frame
from piezo_recorder.reading.reader import read_recording

path, model_file = sys.argv[1:]

recording = read_recording(path)
print(f"{len(recording.voltage_v)} samples, gaps: {recording.gaps}")
print(read_frame(path)[["voltage_v", "displacement_um"]].describe())

system = to_control(load_model(model_file).model)
magnitude, _, _ = control.frequency_response(system, 2.0 * np.pi * np.array([1.0, 100.0, 1000.0]))
print(f"gain at 1, 100 and 1000 Hz: {np.round(magnitude, 3)}")
creep, dynamics, gain, delay_s = from_control(system)
print(f"modes at {np.round(dynamics.mode_frequencies_rad_per_s)} rad/s, "
      f"creep poles at {np.round(creep.poles_rad_per_s, 4)} rad/s")
