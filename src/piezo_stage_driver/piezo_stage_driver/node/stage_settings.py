# SPDX-License-Identifier: BSD-3-Clause
"""The parameters of the stage node, and the objects that are created from them."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from piezo_interfaces.msg import StageAxis, StageDescription
from rclpy.node import Node

from piezo_ros.parameters import declare
from piezo_stage_driver.backends.backend import StageBackend
from piezo_stage_driver.backends.registry import BackendSettings
from piezo_stage_driver.engine.sources import Volts
from piezo_stage_driver.engine.stage_engine import LONGEST_STRETCH_SAMPLES, StageEngine
from piezo_stage_driver.safety.guards import (
    FeedbackOscillation,
    SensorGuard,
    SensorNoise,
    SensorRange,
    SensorResponse,
    StopLatch,
)
from piezo_stage_driver.safety.limits import AxesLimits, FeedbackLimits, VoltageLimits
from piezo_stage_driver.safety.supervisor import StageSupervisor

# Parameters that `StageDescription` contains under the same names.
DESCRIBED = (
    "timing", "sample_rate_hz", "samples_per_tick", "minimum_voltage_v", "maximum_voltage_v",
    "rest_voltage_v", "slew_limit_v_per_s", "ramp_rate_v_per_s", "max_feedback_v",
    "max_feedback_step_v", "max_missed_feedback", "minimum_displacement_um",
    "maximum_displacement_um")

NARROWEST = {
    "minimum_voltage_v": max, "maximum_voltage_v": min, "slew_limit_v_per_s": min,
    "ramp_rate_v_per_s": min, "minimum_displacement_um": max, "maximum_displacement_um": min}
"""How a limit of all axes follows from the limits of the single axes."""


class AxisSettings(NamedTuple):
    """The parameters that may differ between axes, as in ``x.maximum_voltage_v``."""

    minimum_voltage_v: float
    maximum_voltage_v: float
    rest_voltage_v: float
    slew_limit_v_per_s: float
    ramp_rate_v_per_s: float
    minimum_displacement_um: float
    maximum_displacement_um: float
    max_sensor_noise_um: float
    stuck_voltage_v: float
    stuck_displacement_um: float

    @property
    def limits(self) -> VoltageLimits:
        """Return the limits of the voltage; raise LimitError if no voltage is allowed."""
        return VoltageLimits(
            self.minimum_voltage_v, self.maximum_voltage_v, self.slew_limit_v_per_s)

    @property
    def guards(self) -> tuple[SensorGuard, ...]:
        """Return new guards of the sensor."""
        return (SensorRange(self.minimum_displacement_um, self.maximum_displacement_um),
                SensorResponse(self.stuck_voltage_v, self.stuck_displacement_um),
                SensorNoise(self.max_sensor_noise_um))


class StageSettings:
    """Declare the parameters of a node, and keep each value in an attribute of the same name."""

    sample_rate_hz: float
    minimum_voltage_v: float
    maximum_voltage_v: float
    rest_voltage_v: float
    slew_limit_v_per_s: float
    ramp_rate_v_per_s: float
    max_feedback_v: float
    max_feedback_step_v: float
    exchange_timeout_s: float
    emergency_stop_timeout_s: float
    minimum_displacement_um: float
    maximum_displacement_um: float
    max_sensor_noise_um: float
    stuck_voltage_v: float
    stuck_displacement_um: float
    max_feedback_oscillation_v: float
    lockstep_timeout_s: float
    joint_state_rate_hz: float
    real_time_priority: int
    samples_per_tick: int
    samples_per_block: int
    max_missed_feedback: int
    max_limited_feedback: int
    max_foreign_feedback: int
    timing: str
    joint_name: str

    def __init__(self, node: Node) -> None:
        self._node = node
        self._ranges: dict[str, tuple[str, float | None, float | None]] = {}

        def take(name: str, default: float | str, description: str,
                 minimum: float | None = None, maximum: float | None = None,
                 choices: Sequence[str] = ()) -> None:
            self._ranges[name] = description, minimum, maximum
            setattr(self, name, declare(
                node, name, default, description, minimum, maximum, choices=choices))

        take("sample_rate_hz", 40000.0, "Rate of the sample clock (Hz).", 10.0, 200000.0)
        take("samples_per_tick", 40, "Samples of one feedback period.", 1, 4000)
        take("minimum_voltage_v", -20.0, "Lowest voltage allowed (V).", -1000.0, 1000.0)
        take("maximum_voltage_v", 120.0, "Highest voltage allowed (V).", -1000.0, 1000.0)
        take("rest_voltage_v", 0.0, "Voltage while nothing plays (V).", -1000.0, 1000.0)
        take("slew_limit_v_per_s", 2.0e6,
             "Largest voltage step of one sample over the sample period (V/s).", 1.0, 1.0e9)
        take("ramp_rate_v_per_s", 2000.0,
             "Rate of the ramps to the first sample and to rest (V/s).", 1.0, 1.0e6)
        take("max_missed_feedback", 5,
             "More feedback answers missed in a row stop the stage.", 0, 10000)
        take("max_feedback_v", 140.0,
             "A feedback answer beyond it, of either sign, does not act (V).", 1.0e-3, 2000.0)
        take("max_feedback_step_v", 15.0,
             "Largest change of the feedback from one tick to the next (V).", 1.0e-3, 2000.0)
        take("max_limited_feedback", 3,
             "More answers in a row beyond these two limits stop the stage.", 0, 10000)
        take("max_foreign_feedback", 0,
             "More answers from others than the client of the run stop the stage.", 0, 10000)
        take("exchange_timeout_s", 2.0,
             "A backend that has not returned for longer stops the stage (s).", 0.05, 600.0)
        take("emergency_stop_timeout_s", 2.0,
             "What an emergency stop may take beyond the ramp before it answers that it failed "
             "(s).", 0.05, 600.0)
        take("minimum_displacement_um", -45.0,
             "A sensor that reads less stops the stage (um).", -1.0e6, 1.0e6)
        take("maximum_displacement_um", 145.0,
             "A sensor that reads more stops the stage (um).", -1.0e6, 1.0e6)
        take("max_sensor_noise_um", 0.2,
             "Noise of the sensor that stops the stage (um RMS).", 1.0e-6, 1.0e6)
        take("stuck_voltage_v", 20.0,
             "A sensor that does not move while the voltage changes so much stops the stage (V).",
             0.1, 1000.0)
        take("stuck_displacement_um", 0.4,
             "What counts as a move of the sensor (um); more than its noise.", 1.0e-6, 1.0e6)
        take("max_feedback_oscillation_v", 4.0,
             "Feedback that swings by more from peak to peak, and grows, stops the stage (V).",
             1.0e-3, 1000.0)
        take("timing", "paced",
             "paced (the clock of the backend) or lockstep (as fast as the loop answers).",
             choices=("paced", "lockstep"))
        take("lockstep_timeout_s", 10.0,
             "Wall time after which an answer counts as missed in lockstep (s).", 0.01, 600.0)
        # In lockstep single milliseconds do not matter, and each message costs time.
        take("samples_per_block", 2000 if self.lockstep else 800,
             "Samples of one message of samples while nobody has to answer it; at least a tick.",
             1, 40000)
        take("real_time_priority", 40,
             "Priority of the loop of a paced stage, from 1 to 99, with locked memory; 0 requests "
             "neither.", 0, 99)
        take("joint_name", "stage", "Name of the joint in joint_states.")
        take("joint_state_rate_hz", 50.0,
             "Rate of joint_states (Hz), as far as blocks of samples come so often.", 0.1, 1000.0)

    @property
    def lockstep(self) -> bool:
        """Whether stage time waits for the answers."""
        return self.timing == "lockstep"

    def of_axes(self, axes: Sequence[str]) -> list[AxisSettings]:
        """Return the settings of each axis, by default the stage's; a single axis has no name."""
        return [AxisSettings(*(
            declare(self._node, f"{axis}.{name}", getattr(self, name), *self._ranges[name])
            if axis else getattr(self, name) for name in AxisSettings._fields))
            for axis in axes or ("",)]

    def rest_v(self, axes: Sequence[str]) -> Volts:
        """Return the voltage at rest, of each axis if there are several."""
        rests_v = np.array([own.rest_voltage_v for own in self.of_axes(axes)])
        return rests_v if axes else float(rests_v[0])

    def for_backend(self, file: str) -> BackendSettings:
        """Return the settings for a backend; ``file`` holds its own settings."""
        return BackendSettings(
            file=file, sample_rate_hz=self.sample_rate_hz, samples_per_tick=self.samples_per_tick,
            minimum_voltage_v=self.minimum_voltage_v, maximum_voltage_v=self.maximum_voltage_v,
            rest_voltage_v=self.rest_voltage_v, ramp_rate_v_per_s=self.ramp_rate_v_per_s,
            exchange_timeout_s=self.exchange_timeout_s,
            own=lambda axis: {name: getattr(self.of_axes([axis])[0], name) for name in (
                "minimum_voltage_v", "maximum_voltage_v", "rest_voltage_v", "ramp_rate_v_per_s")})

    def create_supervisor(self, backend: StageBackend, latch: StopLatch) -> StageSupervisor:
        """Return the supervisor of a backend.

        Raises ValueError if the limits contradict each other, or are of an axis that the backend
        does not have.
        """
        self._refuse_limits_of_others(getattr(backend, "axes", ()))
        # In lockstep time stops after the last block, which reports the end.
        # A backend with stored waveforms begins to play one only when it is complete.
        lasting = self.lockstep or getattr(backend, "longest_program_samples", None) is not None
        closing_ticks = self._lead_ticks(backend) + 1 if lasting else 0
        return StageSupervisor(backend, self.create_engine, latch, self.max_foreign_feedback,
                               self.exchange_timeout_s, closing_ticks=closing_ticks)

    def description(self, backend: StageBackend) -> StageDescription:
        """Return the description of the stage for other nodes."""
        names = getattr(backend, "axes", ())
        settings = self.of_axes(names)
        described = {name: getattr(self, name) for name in DESCRIBED} | {
            name: narrowest(getattr(own, name) for own in settings)
            for name, narrowest in NARROWEST.items()}
        fields = StageAxis.get_fields_and_field_types().keys() - {"name"}
        return StageDescription(
            backend=getattr(backend, "name", type(backend).__name__),
            lead_ticks=self._lead_ticks(backend), **described,
            signals=list(getattr(backend, "signals", ())),
            axes=[StageAxis(name=axis, **{name: getattr(own, name) for name in fields})
                  for axis, own in zip(names, settings, strict=False)])

    def _refuse_limits_of_others(self, axes: Sequence[str]) -> None:
        """Refuse parameters of axes that the backend lacks, which would limit nothing."""
        # rclpy tells nobody else which parameters were given and never declared.
        for name in self._node._parameter_overrides:
            axis, _, limit = name.partition(".")
            if limit in AxisSettings._fields and axis not in axes:
                raise ValueError(
                    f"parameter {name} is of an axis that the backend does not have, which has "
                    f"{', '.join(axes) or 'one axis without a name'}: correct the name, or the "
                    "axes in the file of the backend")

    def _lead_ticks(self, backend: StageBackend) -> int:
        return getattr(backend, "lead_samples", 0) // self.samples_per_tick

    def create_engine(self, backend: StageBackend, latch: StopLatch) -> StageEngine:
        """Return an engine that drives the backend within the limits and with all guards.

        Raises `LimitError` if the limits contradict each other.
        """
        axes: tuple[str, ...] = getattr(backend, "axes", ())
        one, *_ = settings = self.of_axes(axes)
        by_axis = dict(zip(axes, settings, strict=False))
        return StageEngine(
            backend,
            AxesLimits({axis: own.limits for axis, own in by_axis.items()}) if axes
            else one.limits,
            self.rest_v(axes),
            np.array([own.ramp_rate_v_per_s for own in settings]) if axes
            else one.ramp_rate_v_per_s,
            self.samples_per_tick, self.max_missed_feedback,
            LONGEST_STRETCH_SAMPLES if self.lockstep else self.samples_per_tick,
            sensor_guards={axis: own.guards for axis, own in by_axis.items()} or one.guards,
            feedback_guard={axis: FeedbackOscillation(self.max_feedback_oscillation_v)
                            for axis in axes or ("",)},
            latch=latch,
            feedback_limits=FeedbackLimits(
                self.max_feedback_v, self.max_feedback_step_v, self.max_limited_feedback),
            samples_per_block=self.samples_per_block)
