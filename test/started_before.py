# SPDX-License-Identifier: BSD-3-Clause
"""As this is imported, do once what every fork would do as it starts."""

import numpy as np
from rclpy.impl.rcutils_logger import CallerId

from piezo_models.feedback_law.running_law import compile_law
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_sim.simulated_stage import SimulatedStage
from piezo_stage_driver.safety.sample_kernels import compile_kernels

# Kernels are read from their cache.
compile_law()
compile_kernels()
hysteresis = PreisachModel(0.0, 1.0, np.ones((1, 1)))
hysteresis.gain_um_per_v()
hysteresis.simulate(np.zeros(2))
for plant in None, "xy":
    stage = SimulatedStage(plant)
    stage.open()
    stage.exchange(np.zeros((40, len(stage.axes)) if stage.axes else 40))

CallerId()  # with every first message of a log, inspect looks for the files of all modules
