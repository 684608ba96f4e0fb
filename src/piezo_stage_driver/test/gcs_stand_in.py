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
CURRENT_POSITION, VOLTAGE = 2, 7
INVALID_AXIS, OUT_OF_RANGE = 15, 17


class GCSError(Exception):
    """As ``pipython.GCSError``."""


class Controller:
    """Hold the state of one controller with three axes, each with a channel and a generator.

    Attributes
    ----------
    commands : list of str
        Every command that changed something.
    held : ndarray, shape (3,)
        Voltages that are put out; the position of an axis is `um_per_v` times its voltage, and its
        voltage `v_per_control` times its control value.
    sent_v : list
        The control values of every single command (SVA); a number for one axis, a list for several.
    """

    axes = ("1", "2", "3")

    def __init__(self, um_per_v=1.0, v_per_control=1.0, tables=8, deaf_servo=False,
                 played_scale=1.0):
        self.um_per_v, self.v_per_control, self.played_scale = (
            np.broadcast_to(value, 3) for value in (um_per_v, v_per_control, played_scale))
        self.tables, self.deaf_servo = tables, deaf_servo
        self.commands, self.sent_v = [], []
        self.servo, self.held, self.gone = dict.fromkeys(self.axes, True), np.zeros(3), False
        self.waves, self.selected, self.played, self.rate, self.record_rate = {}, {}, 0, {}, 1
        self.going, self.connected, self.sources, self.record = set(), False, {}, {}
        self.error = 0

    @property
    def running(self):
        """Whether a generator runs."""
        return bool(self.going)

    def answer(self, line):
        """Carry out a command, or return the answer to a question."""
        if self.gone:
            raise OSError("Connection reset by peer")
        if line == "\t":
            return self._pass_time()
        name, *words = line.split()
        try:
            if name.endswith("?"):
                return self._told(name, words)
            self.commands.append(line)
            getattr(self, f"_{name.lower()}")(*words)
        except Refused as error:
            self.error = error.args[0]
        return ""

    def _told(self, name, words):
        told = {
            "*IDN?": lambda: "(c)2026 Physik Instrumente, E-727.3CD, 0123456789, 13.21.00.09",
            "CSV?": lambda: "2.0",
            "ERR?": self._last_error,
            "SAI?": lambda: "\n".join(self.axes),
            "HPA?": lambda: ("0xe000200= 0 1 FLOAT System Servo Update Time\n"
                             "0x16000200= 0 1 INT System Data Recorder Max Points"),
            "TNR?": lambda: str(self.tables),
            "SVO?": lambda: self._of_each(words, lambda at: int(self.servo[self.axes[at]])),
            "POS?": lambda: self._of_each(
                words, lambda at: f"{self.um_per_v[at] * self.held[at]:.6f}"),
            "VOL?": lambda: self._of_each(words, lambda at: f"{self.held[at]:.6f}"),
            "SPA?": lambda: f"{words[0]} {words[1]}=" + {
                0x0E000200: f"{SERVO_S:.6e}", 0x16000200: str(RECORD_POINTS)}[int(words[1], 0)],
            "DRL?": lambda: "\n".join(f"{word}={len(self.record[int(word)])}" for word in words),
            "DRR?": lambda: self._array(*(int(word) for word in words)),
        }
        return told[name]() if name in told else ""

    def _of_each(self, words, value):
        return "\n".join(f"{word}={value(self._at(word))}" for word in words)

    def _last_error(self):
        error, self.error = self.error, 0
        return str(error)

    def _at(self, word, error=INVALID_AXIS):
        """Return the index of an axis, a channel or a generator."""
        if word not in self.axes:
            raise Refused(error)
        return self.axes.index(word)

    def _array(self, first, count, *tables):
        rows = zip(*(self.record[table][first - 1:first - 1 + count] for table in tables),
                   strict=True)
        header = ["# TYPE = 1", "# SEPARATOR = 32", f"# DIM = {len(tables)}",
                  f"# SAMPLE_TIME = {SERVO_S * self.record_rate:.6e}", f"# NDATA = {count}",
                  *(f"# NAME{at} = table {table}" for at, table in enumerate(tables)),
                  "# END_HEADER"]
        return "\n".join([*header, *(" ".join(f"{value:.9g}" for value in row) for row in rows)])

    def _pass_time(self):
        """Let the generators go on; return those that run, one bit each."""
        rates = {self.rate[at] for at in self.going}
        assert rates <= {self.record_rate}, "generators and recorder must have one rate"
        for _ in range(CYCLES_PER_QUESTION // self.record_rate if self.going else 0):
            self.going = {at for at in self.going if self.played < len(self._wave(at))}
            if not self.going:
                break
            # The sensor shows each voltage one sample later.
            before = self.held.copy()
            for at in self.going:
                self.held[at] = (self.played_scale[at] * self.v_per_control[at]
                                 * self._wave(at)[self.played])
            for table, (source, option) in self.sources.items():
                at = self._at(source)
                self.record[table].append(
                    {CURRENT_POSITION: self.um_per_v * before, VOLTAGE: self.held}[option][at])
            self.played += 1
        return f"{sum(1 << at for at in self.going):x}"

    def _wave(self, at):
        return self.waves[self.selected[at]]

    def _svo(self, *words):
        for axis, on in pairs(words):
            self._at(axis)
            self.servo[axis] = self.deaf_servo or bool(int(on))

    def _sva(self, *words):
        assert not self.running
        values = [float(value) for _, value in pairs(words)]
        for (axis, _), value in zip(pairs(words), values, strict=True):
            assert not self.servo[axis]
            self.held[self._at(axis)] = value * self.v_per_control[self._at(axis)]
        self.sent_v.append(values if len(values) > 1 else values[0])

    def _wtr(self, *words):
        for generator, cycles, _ in pairs(words, 3):
            self.rate[self._at(generator, OUT_OF_RANGE)] = int(cycles)

    def _rtr(self, cycles):
        self.record_rate = int(cycles)

    def _drc(self, *words):
        for table, source, option in pairs(words, 3):
            if int(table) > self.tables:
                raise Refused(OUT_OF_RANGE)
            self.sources[int(table)] = (source, int(option))

    def _wcl(self, *tables):
        assert not self.running
        for table in tables:
            self.waves[table] = []

    def _wav(self, table, append, kind, first, count, *points):
        wave = self.waves.setdefault(table, [])
        assert kind == "PNT" and (append == "X") == (not wave)
        assert int(count) == len(points) and int(first) == len(wave) + 1
        wave += [float(point) for point in points]

    def _wsl(self, *words):
        assert not self.running
        for generator, table in pairs(words):
            self.selected[self._at(generator, OUT_OF_RANGE)] = table

    def _wgc(self, *words):
        assert all(cycles == "1" for _, cycles in pairs(words))

    def _wgo(self, *words):
        starts = {self._at(generator, OUT_OF_RANGE)
                  for generator, mode in pairs(words) if mode == "1"}
        self.going -= {self._at(generator) for generator, _ in pairs(words)}
        if starts:
            assert not any(self.servo[self.axes[at]] for at in starts)
            self.going |= starts
            self.played, self.record = 0, {table: [] for table in self.sources}


class Refused(Exception):
    """A command that the controller does not carry out, with the number of its error."""


def pairs(words, size=2):
    """Return the words of a command in groups."""
    return list(zip(*(words[at::size] for at in range(size)), strict=True))


def library(controller):
    """Tell what `pi_gcs_stage.load_library` would return."""
    class Socket:
        def __init__(self, host):
            if controller.gone:
                raise OSError("No route to host")
            controller.connected = True

    def listed(items):
        return list(items) if isinstance(items, (list, tuple)) else [items]

    def ask(name, items, convert):
        lines = controller.answer(f"{name}? {' '.join(map(str, listed(items)))}").splitlines()
        raise_error()
        return {item: convert(line.split("=")[1])
                for item, line in zip(listed(items), lines, strict=True)}

    def tell(name, *columns):
        """Send a command with the entries of all columns in turn, and ask for its error."""
        rows = zip(*(listed(column) for column in columns), strict=True)
        words = [int(word) if isinstance(word, bool) else word for row in rows for word in row]
        controller.answer(" ".join(map(str, [name, *words])))
        raise_error()

    def raise_error():
        if (error := int(controller.answer("ERR?"))):
            raise GCSError({15: "Invalid axis identifier", 17: "Parameter out of range"}[error])

    class GCSDevice:
        def __init__(self, devname="", gateway=None):
            self.bufstate = self.bufdata = None

        def ConnectUSB(self, serialnum):  # noqa: N802
            controller.connected = True

        def __exit__(self, *error):
            controller.connected = False

        def IsGeneratorRunning(self, wavegens):  # noqa: N802
            bits = int(controller.answer("\t"), 16)
            return {generator: bool(bits >> generator - 1 & 1) for generator in listed(wavegens)}

        def qSAI(self):  # noqa: N802
            return controller.answer("SAI?").split()

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

        def WCL(self, tables):  # noqa: N802
            controller.answer(f"WCL {' '.join(map(str, listed(tables)))}")

        def __getattr__(self, name):
            if name.startswith("q"):
                return lambda items: ask(name[1:], items, float)
            return lambda *columns: tell(name, *columns)

    return SimpleNamespace(GCSDevice=GCSDevice, Error=GCSError, Socket=Socket)
