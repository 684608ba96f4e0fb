# SPDX-License-Identifier: BSD-3-Clause
"""List the visible stages, and report the status of one of them."""

import math
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from lifecycle_msgs.srv import GetState

from piezo_client.client import Client, nobody_serves
from piezo_client.rejections import DIAGNOSTICS_S
from piezo_ros.stage_runs.described_stage import DescribedStage

NODES = ("stage", "recorder", "identification", "controller")

SERVE_GOALS = {"identification", "controller"}


def stages_seen(client: Client, wait_s: float) -> dict[str, set[str]]:
    """Return the nodes of each namespace that has a stage, the stage included.

    It looks for a stage for some seconds, and raises `ServiceFailed` if there is none.
    """
    client.spin_until(lambda: bool(_namespaces(client)), wait_s)
    found = _namespaces(client)
    if not found:
        raise nobody_serves("")
    return found


def _namespaces(client: Client) -> dict[str, set[str]]:
    """Return the nodes of each namespace that has a stage."""
    seen: dict[str, set[str]] = {}
    for name, namespace in client.node.get_node_names_and_namespaces():
        if name in NODES:
            seen.setdefault(namespace, set()).add(name)
    return {namespace: names for namespace, names in seen.items() if "stage" in names}


def status_lines(client: Client) -> tuple[list[str], bool]:
    """Return lines with the status of the stage in a client's namespace.

    Also returned is whether the stage stays at rest until it is reset. Raises `ServiceFailed` if
    there is no such stage.
    """
    heard: dict[str, DiagnosticStatus] = {}

    def hear(message: DiagnosticArray) -> None:
        heard.update({status.name: status for status in message.status})

    client.node.create_subscription(DiagnosticArray, "/diagnostics", hear, 10)
    described = DescribedStage(client.node)
    namespace = client.node.get_namespace().rstrip("/")
    state = client.call(GetState, "stage/get_state").current_state.label
    lines = [f"{namespace}/stage is {state}"]
    if state == "unconfigured":
        lines.append(f"configure and activate it: ros2 lifecycle set {namespace}/stage configure, "
                     "then activate; or start it with -p autostart:=true")
    else:
        lines += _description(client.description(described))
    name = f"{namespace}/stage: stage"
    if client.spin_until(lambda: name in heard, DIAGNOSTICS_S):
        lines += _present(heard[name])
    at_work = {f"{namespace}/{node}: goal" for node in SERVE_GOALS & client.neighbours()}
    client.spin_until(lambda: at_work <= heard.keys(), DIAGNOSTICS_S)
    lines += [f"{status.name.partition(': ')[0]}: {status.message}"
              for key, status in sorted(heard.items())
              if key.startswith(f"{namespace}/") and key.endswith(": goal")]
    missing = [name for name in NODES if name not in client.neighbours()]
    lines.append(f"not there: {', '.join(missing)}" if missing else "all nodes are there")
    return lines, name in heard and heard[name].level == DiagnosticStatus.ERROR


def _description(stage: Any) -> list[str]:
    return [
        f"backend {stage.backend}, {stage.timing}, {stage.sample_rate_hz:g} Hz, feedback every "
        f"{stage.samples_per_tick} samples",
        *(f"{f'{axis.name} ' if stage.axes else ''}voltage {axis.minimum_voltage_v:g} to "
          f"{axis.maximum_voltage_v:g} V, at rest {axis.rest_voltage_v:g} V, at most "
          f"{axis.slew_limit_v_per_s:g} V/s" for axis in stage.axes or [stage])]


def _present(status: DiagnosticStatus) -> list[str]:
    values = {entry.key: entry.value for entry in status.values}
    client = f" for {values['client']}" if values.get("client") else ""
    voltage = f", {values['voltage_v']} V" if "voltage_v" in values else ""
    remaining_s = float(values.get("seconds_left", 0.0))
    remaining = f", {remaining_s:.3g} s left" if 0.0 < remaining_s < math.inf else ""
    return [f"now: {status.message}{client}{voltage}{remaining}"]
