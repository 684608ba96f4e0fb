# SPDX-License-Identifier: BSD-3-Clause
"""A controller of PI: what the manual of E-727 says of its GCS commands, and a stage behind it.

It takes and answers command lines. Time passes only while somebody asks whether the wave generator
runs. `library` is the part of the package ``pipython`` that a stage needs, over such lines.
"""

from types import SimpleNamespace

import numpy as np

SERVO_S = 50e-6
RECORD_POINTS = 262144
CYCLES_PER_QUESTION = 20000


class GCSError(Exception):
    """As ``pipython.GCSError``."""


class Controller:
    """Hold the state of one controller.

    Attributes
    ----------
    commands : list of str
        Every command that changed something.
    held : float
        Control value that is put out; the stage has 1 um and 1 V for each of it.
    sent_v : list of float
        Every value of a single command (SVA).
    """

    def __init__(self, um_per_v=1.0, tables=8, deaf_servo=False, played_scale=1.0):
        self.um_per_v, self.tables = um_per_v, tables
        self.deaf_servo, self.played_scale = deaf_servo, played_scale
        self.commands, self.sent_v = [], []
        self.servo, self.held, self.gone = True, 0.0, False
        self.wave, self.played, self.rate, self.record_rate = [], 0, 1, 1
        self.running, self.connected, self.sources = False, False, {}
        self.record = {1: [], 2: []}

    def answer(self, line):
        """Carry out a command, or return the answer to a question."""
        if self.gone:
            raise OSError("Connection reset by peer")
        if line == "\t":
            return self._pass_time()
        name, *words = line.split()
        if name.endswith("?"):
            return self._told(name, words)
        self.commands.append(line)
        getattr(self, f"_{name.lower()}")(*words)
        return ""

    def _told(self, name, words):
        told = {
            "*IDN?": lambda: "(c)2026 Physik Instrumente, E-727.3CD, 0123456789, 13.21.00.09",
            "CSV?": lambda: "2.0",
            "ERR?": lambda: "0",
            "SAI?": lambda: "1 \n2 \n3",
            "HPA?": lambda: ("0xe000200= 0 1 FLOAT System Servo Update Time\n"
                             "0x16000200= 0 1 INT System Data Recorder Max Points"),
            "TNR?": lambda: str(self.tables),
            "SVO?": lambda: f"{words[0]}={int(self.servo)}",
            "POS?": lambda: f"{words[0]}={self.um_per_v * self.held:.6f}",
            "VOL?": lambda: f"{words[0]}={self.held:.6f}",
            "SPA?": lambda: f"{words[0]} {words[1]}=" + {
                0x0E000200: f"{SERVO_S:.6e}", 0x16000200: str(RECORD_POINTS)}[int(words[1], 0)],
            "DRL?": lambda: "\n".join(f"{word}={len(self.record[int(word)])}" for word in words),
            "DRR?": lambda: self._array(*(int(word) for word in words)),
        }
        return told[name]() if name in told else ""

    def _array(self, first, count, *tables):
        rows = zip(*(self.record[table][first - 1:first - 1 + count] for table in tables),
                   strict=True)
        header = ["# TYPE = 1", "# SEPARATOR = 32", f"# DIM = {len(tables)}",
                  f"# SAMPLE_TIME = {SERVO_S * self.record_rate:.6e}", f"# NDATA = {count}",
                  *(f"# NAME{at} = table {table}" for at, table in enumerate(tables)),
                  "# END_HEADER"]
        return "\n".join([*header, *(" ".join(f"{value:.9g}" for value in row) for row in rows)])

    def _pass_time(self):
        if self.running:
            assert self.rate == self.record_rate, "generator and recorder must have one rate"
            for _ in range(CYCLES_PER_QUESTION // self.rate):
                if self.played == len(self.wave):
                    self.running = False
                    break
                # The sensor shows each voltage one sample later.
                self.record[1].append(self.um_per_v * self.held)
                self.held = self.played_scale * self.wave[self.played]
                self.record[2].append(self.held)
                self.played += 1
        return str(int(self.running))

    def _svo(self, axis, on):
        self.servo = self.deaf_servo or bool(int(on))

    def _sva(self, axis, value):
        assert not self.servo and not self.running
        self.held = float(value)
        self.sent_v.append(self.held)

    def _wtr(self, generator, cycles, interpolation):
        self.rate = int(cycles)

    def _rtr(self, cycles):
        self.record_rate = int(cycles)

    def _drc(self, table, source, option):
        self.sources[int(table)] = (source, int(option))

    def _wcl(self, table):
        assert not self.running
        self.wave = []

    def _wav(self, table, append, kind, first, count, *points):
        assert kind == "PNT" and (append == "X") == (not self.wave)
        assert int(count) == len(points) and int(first) == len(self.wave) + 1
        self.wave += [float(point) for point in points]

    def _wsl(self, generator, table):
        pass

    def _wgc(self, generator, cycles):
        assert cycles == "1"

    def _wgo(self, generator, mode):
        self.running = mode == "1"
        if self.running:
            assert not self.servo
            self.played, self.record = 0, {1: [], 2: []}


def library(controller):
    """Tell what `pi_gcs_stage.load_library` would return."""
    class Socket:
        def __init__(self, host):
            if controller.gone:
                raise OSError("No route to host")
            controller.connected = True

    class GCSDevice:
        def __init__(self, devname="", gateway=None):
            self.bufstate = self.bufdata = None

        def ConnectUSB(self, serialnum):  # noqa: N802
            controller.connected = True

        def close(self):
            controller.connected = False

        def IsGeneratorRunning(self, wavegens):  # noqa: N802
            return {wavegens: controller.answer("\t") == "1"}

        def qTNR(self):  # noqa: N802
            return int(controller.answer("TNR?"))

        def qSPA(self, items, params):  # noqa: N802
            value = controller.answer(f"SPA? {items} {params}").split("=")[1]
            return {items: {params: float(value)}}

        def qDRR(self, tables, offset, numvalues):  # noqa: N802
            text = controller.answer(f"DRR? {offset} {numvalues} {' '.join(map(str, tables))}")
            rows = text.split("# END_HEADER\n")[1].splitlines()
            self.bufdata = np.array([row.split() for row in rows], dtype=float).T.tolist()
            self.bufstate = True

        def WAV_PNT(self, table, firstpoint, numpoints, append, wavepoint):  # noqa: N802
            points = " ".join(map(str, wavepoint))
            controller.answer(f"WAV {table} {append} PNT {firstpoint} {numpoints} {points}")

        def __getattr__(self, name):
            if name.startswith("q"):
                def ask(item):
                    return {item: float(controller.answer(f"{name[1:]}? {item}").split("=")[1])}
                return ask

            def command(*words):
                words = [int(word) if isinstance(word, bool) else word for word in words]
                controller.answer(" ".join(map(str, [name, *words])))
            return command

    return SimpleNamespace(GCSDevice=GCSDevice, Error=GCSError, Socket=Socket)
