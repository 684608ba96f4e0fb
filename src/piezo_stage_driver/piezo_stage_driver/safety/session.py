# SPDX-License-Identifier: BSD-3-Clause
"""One session of the backend, from its opening to its end; after a fault it is only closed."""

import contextlib
import threading
from collections.abc import Callable
from typing import Any

import numpy as np

from piezo_stage_driver.backends.backend import BackendFault, StageBackend


class SessionOver(BackendFault):
    """The backend was given up while a call had not returned."""


class BackendSession:
    """A backend between ``open`` and ``close``, as the engine drives it."""

    def __init__(self, backend: StageBackend, clock: Callable[[], float]):
        self._backend, self._clock = backend, clock
        self.sample_rate_hz = backend.sample_rate_hz
        self.axes = getattr(backend, "axes", ())
        self.lead_samples = getattr(backend, "lead_samples", 0)
        self.longest_program_samples = getattr(backend, "longest_program_samples", None)
        self.signals: tuple[str, ...] = tuple(getattr(backend, "signals", ()))
        self._marks: np.ndarray | None = None
        self._signal = np.empty((0, len(self.signals)))
        self._lock = threading.Lock()
        self._over = False
        self._began_s: float | None = None

    @property
    def waited_s(self) -> float:
        """Return how long the present call of the backend has lasted (s); 0 between two calls."""
        began_s = self._began_s
        return 0.0 if began_s is None else self._clock() - began_s

    @property
    def busy(self) -> bool:
        """Return whether a call of the backend has not returned yet."""
        return self._began_s is not None

    def open(self) -> None:
        """Open the backend; see ``StageBackend.open``."""
        self._backend.open()

    def watch_stop(self, stopped: Callable[[], bool]) -> None:
        """Pass a backend that plays whole waveforms a function that reports a stop."""
        watch = getattr(self._backend, "watch_stop", None)
        if watch is not None:
            watch(stopped)

    def put_out_marks(self, marks: np.ndarray) -> None:
        """Put out marks with the samples of the next exchange, if the backend can."""
        if hasattr(self._backend, "put_out_marks"):
            self._marks = marks

    def read_signals(self) -> np.ndarray:
        """Return what the detectors measured in the last exchange, shape (n, signals)."""
        return self._signal

    def exchange(self, voltage_v: np.ndarray) -> np.ndarray:
        """Play samples; see ``StageBackend.exchange``.

        Raises `BackendFault` if the backend raises anything, and closes it; `SessionOver` if the
        session was given up, and the backend is closed as soon as it returns.
        """
        with self._lock:
            if self._over:
                raise SessionOver("the backend was given up: activate the stage again")
            self._began_s = self._clock()
        fault: BackendFault | None = None
        displacement_um = np.empty(0)
        try:
            displacement_um = self._exchanged(self._backend, voltage_v)
        except BackendFault as raised:
            fault = raised
        except Exception as error:  # of any kind: the backend must not be driven any further
            fault = BackendFault(f"the backend broke: {error!r}", at_rest=False)
            fault.__cause__ = error
        with self._lock:
            given_up, self._over = self._over, self._over or fault is not None
            self._began_s = None
        if given_up or fault:
            self._close()
        if given_up:
            raise SessionOver("the backend was given up: activate the stage again")
        if fault:
            raise fault
        return displacement_um

    def give_up(self) -> None:
        """Block all further calls of the backend from any thread; close it once it returns."""
        with self._lock:
            over, self._over = self._over, True
            busy = self.busy
        if not (over or busy):
            self._close()

    def close(self) -> None:
        """Close the backend, unless that is done."""
        with self._lock:
            over, self._over = self._over, True
        if not over:
            self._backend.close()

    def _close(self) -> None:
        # A backend that has failed may fail to close as well; its fault has been reported.
        with contextlib.suppress(Exception):
            self._backend.close()

    def _exchanged(self, backend: Any, voltage_v: np.ndarray) -> np.ndarray:
        """Exchange samples, with the methods that only some backends have."""
        if self._marks is not None:
            backend.put_out_marks(self._marks)
            self._marks = None
        displacement_um = _checked("displacements", backend.exchange(voltage_v), voltage_v.shape)
        if self.signals:
            self._signal = _checked("signals", backend.read_signals(),
                                    (len(voltage_v), len(self.signals)))
        return displacement_um


def _checked(name: str, values: object, shape: tuple[int, ...]) -> np.ndarray:
    found = np.asarray(values, dtype=float)
    if found.shape != shape:
        raise BackendFault(f"the backend returned {name} of shape {found.shape}, not {shape}: "
                           "give one for each sample", at_rest=False)
    return found
