# SPDX-License-Identifier: BSD-3-Clause
"""The interface of the hardware, or of its simulation, to the stage node."""

from typing import Protocol

import numpy as np


class BackendFault(RuntimeError):
    """A failure of the hardware, which the text describes.

    The backend has brought the amplifier to rest by itself, as far as it still could: after a fault
    the stage node calls ``close``, and nothing else before the next ``open``.

    Parameters
    ----------
    at_rest : bool
        False if the amplifier could not be brought to rest, or that is unknown; users are then
        advised to cut its supply.
    """

    def __init__(self, text: str, at_rest: bool = True):
        super().__init__(text)
        self.at_rest = at_rest


class StageBackend(Protocol):
    """Amplifiers and displacement sensors of one axis or several, on one sample clock.

    The stage node calls ``open``, then ``exchange`` repeatedly from one thread, then ``close``.
    After a `BackendFault` of ``exchange`` it calls ``close`` once and nothing else, until the stage
    is activated again, which begins with ``open``. Any other exception counts as a fault in which
    the amplifier keeps its voltage.

    A backend may also have a method ``emergency_rest() -> None``: its own return to rest, which the
    node calls from another thread while ``exchange`` hangs. It returns once the amplifier is at
    rest, and raises BackendFault if it cannot get there. In any case the hanging exchange may
    return meanwhile or later; ``close`` follows it.

    An attribute ``name : str`` gives the name of the hardware for other nodes; the default is the
    name of the class.

    A backend of two or three axes names them by an attribute ``axes : tuple of str``; it exchanges
    a column for each, all of one sample at the same instant. Names are short and lower-case.

    A backend with digital outputs has a method ``put_out_marks(marks)``. Where samples have marks,
    the node calls it before their ``exchange``, with one byte each, (n,). Bit i is put out on line
    i when the voltage of the sample is applied; without a call all lines are low.

    A backend with detectors names them by an attribute ``signals : tuple of str``. Its method
    ``read_signals()`` returns what they measured at the samples of the last exchange, shape
    (n, signals), at the instants of the displacements.

    A backend that can only play whole waveforms, such as one with a waveform memory, has an
    attribute ``longest_program_samples : int``, with as many ``lead_samples``. It then receives
    only waveforms that end at rest within that length. Its optional method ``watch_stop(stopped)``
    takes a function that returns whether the stage was stopped while a waveform plays.

    Attributes
    ----------
    sample_rate_hz : float
        Rate of the sample clock.
    lead_samples : int
        Number of samples by which the voltages are written ahead of the clock, if samples cannot
        be exchanged at the last instant; 0 if the attribute is missing. Whole ticks.
    """

    sample_rate_hz: float
    lead_samples: int = 0

    def open(self) -> None:
        """Start the sample clock with the amplifier at the rest voltage.

        Raises
        ------
        ValueError, OSError, BackendFault
            If the hardware is missing or does not support the settings. Nothing is left open then:
            no ``close`` follows.
        """

    def exchange(self, voltage_v: np.ndarray) -> np.ndarray:
        """Play samples and return what was measured meanwhile.

        Parameters
        ----------
        voltage_v : ndarray, shape (n,) or (n, axes)
            Voltages, each of which is held for one sample period.

        Returns
        -------
        displacement_um : ndarray, of the same shape
            Sample i is taken at the instant at which ``voltage_v[i]`` is applied, and so does
            not yet respond to it; with a lead, the voltage given ``lead_samples`` before it.
            Measurements before the first voltage is applied do not count.

        Raises
        ------
        BackendFault
            If samples were lost or could not be played in time.
        """

    def close(self) -> None:
        """Stop the sample clock; the amplifier stays at its last voltage."""
