# SPDX-License-Identifier: BSD-3-Clause
"""Find a backend by its name: those of this package, and those registered by other packages."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from piezo_common.registered import registered
from piezo_stage_driver.backends.backend import StageBackend

GROUP = "piezo_stage_driver.backends"


@dataclass(frozen=True)
class BackendSettings:
    """Settings that the stage node passes to a backend."""

    file: str
    """File of the backend's own settings; empty if none was given."""
    sample_rate_hz: float
    samples_per_tick: int
    minimum_voltage_v: float
    maximum_voltage_v: float
    rest_voltage_v: float

    ramp_rate_v_per_s: float
    """Rate at which a backend brings the amplifier to rest by itself (V/s)."""
    exchange_timeout_s: float = 2.0
    """Time that the node waits for one exchange (s)."""
    own: Callable[[str], Mapping[str, Any]] = field(default=lambda axis: {}, compare=False)
    """Returns the voltages and the ramp rate of an axis, see `of_axis`."""

    def of_axis(self, axis: str) -> "BackendSettings":
        """Return the settings with the voltages and the ramp rate of one of several axes.

        A single axis has the name ``""`` and these settings.
        """
        return replace(self, **self.own(axis)) if axis else self


def create_backend(name: str, settings: BackendSettings) -> StageBackend:
    """Create the backend with a name in the entry points ``piezo_stage_driver.backends``.

    Raises
    ------
    ValueError
        If there is none of this name, or it cannot be loaded or created.
    """
    check_backend(name)
    return registered(GROUP)[name](settings)


def check_backend(name: str) -> None:
    """Raise ValueError, which lists the known names, if no package registers a backend of a name.

    No backend is loaded.
    """
    known = registered(GROUP)
    if name not in known:
        raise ValueError(f"there is no backend {name!r}: set the parameter backend to "
                         f"{' or '.join(sorted(known))}, or install the package that has it")
