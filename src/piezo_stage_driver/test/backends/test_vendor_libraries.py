# SPDX-License-Identifier: BSD-3-Clause
"""The vendors' own libraries over the stand-ins' command lines, where they are installed."""

import functools
import socketserver
import threading

import gcs_stand_in
import numpy as np
import nv200_stand_in
import pytest
from stored_waveform_runs import (
    BOTH_V,
    CONFIG,
    LONGEST,
    WAVE_V,
    axes_engine_of,
    engine_of,
    of_y,
    pi_axes,
    played,
    settings,
)

from piezo_common.schema import checked, load_document
from piezo_stage_driver.backends import nv200_stage, pi_gcs_stage
from piezo_stage_driver.backends.stored_waveforms import StoredWaveformStage


def plays_through(instrument, make_engine=engine_of, waveform_v=WAVE_V):
    stage = StoredWaveformStage(instrument, settings(own=of_y), LONGEST, 10.0)
    for _ in range(2):
        stage.open()
        voltage_v, displacement_um = played(make_engine(stage), waveform_v)
        stage.close()
        assert np.allclose(displacement_um[1:], voltage_v[:-1], atol=1e-4)


@pytest.fixture
def served():
    """Serve the stand-in of a controller on a port of this machine."""
    controller = gcs_stand_in.Controller()

    class Handler(socketserver.StreamRequestHandler):
        def handle(self):
            while line := self._line():
                told = controller.answer(line)
                if told or "?" in line:
                    # Every line but the last of an answer ends with a space.
                    self.wfile.write((told.replace("\n", " \n") + "\n").encode())

        def _line(self):
            """Return a command: a line, or a single control character."""
            first = self.rfile.read(1).decode()
            if first in ("\t", ""):
                return first
            return (first + self.rfile.readline().decode()).rstrip("\n")

    class Server(socketserver.ThreadingTCPServer):
        daemon_threads = True

    with Server(("127.0.0.1", 0), Handler) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        yield server.server_address[1]
        server.shutdown()
        thread.join()


@pytest.fixture
def pipython(served):
    pytest.importorskip("pipython", reason="the optional package is not installed")
    library = pi_gcs_stage.load_library()
    library.Socket = functools.partial(library.Socket, port=served)
    return library


def test_pipython_speaks_to_the_stand_in(pipython):
    told = load_document(pi_gcs_stage.PiSettings, CONFIG / "pi_gcs_settings.yaml")
    told = told.model_copy(update={"address": "127.0.0.1"})
    plays_through(pi_gcs_stage.PiController(told, pipython))


def test_pipython_drives_two_axes_together(pipython):
    told = checked(pi_gcs_stage.PiAxesSettings, pi_axes(
        control_per_v=1.0, displacement_um_per_unit=1.0) | {"address": "127.0.0.1"})
    plays_through(pi_gcs_stage.PiController(told, pipython), axes_engine_of, BOTH_V)


def test_nv200_library_speaks_to_the_stand_in():
    pytest.importorskip("nv200", reason="the optional package is not installed")
    from nv200.nv200_device import NV200Device
    from nv200.transport_protocol import TransportProtocol
    box = nv200_stand_in.Box()

    class Transport(TransportProtocol):
        async def connect(self, auto_adjust_comm_params=True, device=None):
            self.told = ""

        async def read_until(self, expected=b"\x11", timeout=1.0):
            return self.told

        async def write(self, cmd):
            self.told = box.answer(cmd) + "\r\n"

        async def flush_input(self):
            pass

        async def close(self):
            pass

        def get_info(self):
            raise NotImplementedError

    async def connect(interface, address):
        device = NV200Device(Transport())
        await device.connect(auto_adjust_comm_params=False)
        return device

    library = nv200_stage.load_library()
    library.connect = connect
    told = load_document(nv200_stage.Nv200Settings, CONFIG / "nv200_settings.yaml")
    plays_through(nv200_stage.Nv200(told, library))
