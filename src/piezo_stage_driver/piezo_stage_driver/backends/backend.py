# SPDX-License-Identifier: BSD-3-Clause
"""What the stage node asks of the hardware, or of its simulation."""

from typing import Protocol

import numpy as np


class BackendFault(RuntimeError):
    """The hardware failed; its text says how.

    Who raises it has brought the amplifier to rest by itself, as well as it still could: after a
    fault the stage node calls ``close``, and nothing else before the next ``open``.

    Parameters
    ----------
    text : str
        What failed.
    at_rest : bool
        False where the amplifier could not be brought to rest, or that is not known; people are
        then told to cut its supply.
    """

    def __init__(self, text: str, at_rest: bool = True):
        super().__init__(text)
        self.at_rest = at_rest


class StageBackend(Protocol):
    """Amplifiers and displacement sensors of one axis or several, on one sample clock.

    The stage node calls ``open``, then ``exchange`` again and again from one thread, then
    ``close``. After a `BackendFault` of ``exchange`` it calls ``close`` once and nothing else,
    until the stage is activated again, which begins with ``open``. Any other exception counts as a
    fault that left the amplifier where it was.

    A backend may also have a method ``emergency_rest() -> None``: its own way to rest, which the
    node calls from another thread while ``exchange`` hangs. It returns once the amplifier is at
    rest, and raises BackendFault where it cannot get there. Whatever it does, the exchange that
    hangs may return meanwhile or later; ``close`` follows it.

    An attribute ``name : str`` tells other nodes what drives the stage; the name of the class does
    where it is missing.

    A backend of two or three axes names them by an attribute ``axes : tuple of str``; it exchanges
    a column for each, all of one sample at the same instant. Names are short and lower-case.

    A backend that can only play whole waveforms, as one with a waveform memory does, says so by an
    attribute ``longest_program_samples : int``, with as many ``lead_samples``: it is then asked for
    nothing but waveforms that end at rest within so many samples. A method ``watch_stop(stopped)``
    takes what tells it that the stage was stopped while a waveform plays.

    Attributes
    ----------
    sample_rate_hz : float
        Rate of the sample clock.
    lead_samples : int
        How far the voltages are written ahead of the clock, where samples cannot be exchanged at
        the last instant; 0 where the attribute is missing. Whole ticks.
    """

    sample_rate_hz: float
    lead_samples: int = 0

    def open(self) -> None:
        """Start the sample clock with the amplifier at the rest voltage.

        Raises
        ------
        ValueError, OSError, BackendFault
            If the hardware is not there or cannot do what it is asked. Nothing is left open then:
            no ``close`` follows.
        """

    def exchange(self, voltage_v: np.ndarray) -> np.ndarray:
        """Play samples and return what was measured meanwhile.

        Parameters
        ----------
        voltage_v : ndarray, shape (n,) or (n, axes)
            Each is held for one sample period.

        Returns
        -------
        displacement_um : ndarray, of the same shape
            Sample i is taken at the instant at which ``voltage_v[i]`` is applied, and so does
            not yet respond to it; with a lead, the voltage given ``lead_samples`` before it.
            What is measured before the first voltage is applied does not count.

        Raises
        ------
        BackendFault
            If samples were lost or could not be played in time.
        """

    def close(self) -> None:
        """Stop the sample clock; the amplifier stays at its last voltage."""
