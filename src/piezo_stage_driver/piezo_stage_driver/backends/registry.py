# SPDX-License-Identifier: BSD-3-Clause
"""Find a backend by its name: ours, and those that other packages announce."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from piezo_common.registered import registered
from piezo_stage_driver.backends.backend import StageBackend

GROUP = "piezo_stage_driver.backends"


@dataclass(frozen=True)
class BackendSettings:
    """What the stage node tells a backend.

    Attributes
    ----------
    file : str
        Of the backend's own settings; empty where none was given.
    ramp_rate_v_per_s : float
        For a backend that must bring the amplifier to rest by itself.
    exchange_timeout_s : float
        How long the node waits for one exchange.
    own : callable
        Returns the voltages and the ramp rate that an axis has of its own, see `of_axis`.
    """

    file: str
    sample_rate_hz: float
    samples_per_tick: int
    minimum_voltage_v: float
    maximum_voltage_v: float
    rest_voltage_v: float
    ramp_rate_v_per_s: float
    exchange_timeout_s: float = 2.0
    own: Callable[[str], Mapping[str, Any]] = field(default=lambda axis: {}, compare=False)

    def of_axis(self, axis: str) -> "BackendSettings":
        """Return the settings with the voltages and the ramp rate of one of several axes."""
        return replace(self, **self.own(axis))


def create_backend(name: str, settings: BackendSettings) -> StageBackend:
    """Make the backend that an entry point of the group ``piezo_stage_driver.backends`` names.

    Raises
    ------
    ValueError
        If there is none of this name, or it cannot be loaded or made.
    """
    check_backend(name)
    return registered(GROUP)[name](settings)


def check_backend(name: str) -> None:
    """Refuse the name of a backend that no package announces; load none.

    Raises
    ------
    ValueError
        With the names that there are.
    """
    known = registered(GROUP)
    if name not in known:
        raise ValueError(f"there is no backend {name!r}: set the parameter backend to "
                         f"{' or '.join(sorted(known))}, or install the package that has it")
