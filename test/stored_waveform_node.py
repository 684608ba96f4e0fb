# SPDX-License-Identifier: BSD-3-Clause
"""A stage behind a stand-in of a controller that plays stored waveforms.

Its arguments: the folder of the stand-in, the settings of the backend, the longest waveform.
"""

import sys

from piezo_common.schema import load_document
from piezo_ros.spinning import run_node
from piezo_stage_driver.backends.pi_gcs_stage import PiController, PiSettings
from piezo_stage_driver.backends.stored_waveforms import StoredWaveformStage
from piezo_stage_driver.node.stage_node import StageNode


def main():
    folder, settings, longest_samples = sys.argv[1:4]
    sys.path.insert(0, folder)
    import gcs_stand_in

    def make(node):
        controller = PiController(load_document(PiSettings, settings),
                                  gcs_stand_in.library(gcs_stand_in.Controller()))
        return StoredWaveformStage(
            controller, node.settings.for_backend(settings), int(longest_samples), 30.0)

    run_node(lambda: StageNode(make), sys.argv)
