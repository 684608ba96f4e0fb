# SPDX-License-Identifier: BSD-3-Clause
"""The demo's second part: a stage that changes while it tracks, and a cause to be decided.

Both use the extended model of the first part, on the same stage with one further change.
"""

import json
from dataclasses import asdict, dataclass
from importlib import resources
from pathlib import Path

import yaml

from piezo_client.model_offers import accept_extended_model, offered_model
from piezo_sim.plant.named_plants import PLANTS
from piezo_studies.demo.demo_session import MEETINGS

# Excites the modes: 20 um at 50 Hz and further tones near each of the first two modes.
REFERENCE = {"kind": "multi_frequency", "frequency_hz": [50.0, 400.0, 750.0],
             "amplitude_um": [20.0, 8.0, 4.0], "centre_um": 57.0}
MONITOR = {"block_s": 0.1, "learning_blocks": 20, "diagnosed_s": 0.5,
           "directory": "monitor/changes"}
FASTER = 1.03
# Time of the change after the rest before the run, longer than the monitor learns.
CHANGE_AFTER_S, CHANGING_S, COMPARED_S = 4.0, 6.0, 0.5
OFFER_TIMEOUT_S = 120.0

# A scan line for which a lag and a delay differ only by (w T)^2 / 2, that is 0.1 nm.
SCAN = {"kind": "harmonic", "frequency_hz": [20.0], "amplitude_um": [10.0], "centre_um": 50.0}
SCAN_S = 0.2
LAG_S = 5e-5
LONGEST_S = 0.2


@dataclass(frozen=True)
class Monitored:
    """The results for a mode that became faster while the stage tracked."""

    change_s: float
    since_s: float
    """Stage time of the change, and its estimate by the monitor."""
    sentence: str
    """Result of the monitor in words."""
    before_rms_um: float
    after_rms_um: float
    """RMS of the residual of the original model, and of the offered model."""
    e_rms_before_percent: float
    e_rms_after_percent: float
    """Tracking errors by the sensor with the original model and with the accepted one."""
    extended_model: str
    """Path of the offered model."""


@dataclass(frozen=True)
class Decided:
    """The decision by one proposed recording."""

    hidden: str
    """Effect of the simulated stage that is unknown to the model."""
    experiment: str
    """Description of the played experiment."""
    before: dict[str, float]
    after: dict[str, float]
    """Probability of each explanation before and after it."""
    decision: str
    sentence: str
    """The decision and the verdict in words."""
    report: str
    """Path of the report."""


def start_changing_stage(session, plant, directory):
    """Start the stage on which a mode becomes faster, and the monitor, without waiting for them.

    The stage time of the change is returned; None if the plant has no mode that can change, and
    nothing is started.
    """
    change_s = (MEETINGS + 1) * session.rest_s + CHANGE_AFTER_S
    content = with_faster_mode(plant, FASTER, change_s)
    if content is None:
        return None
    session.start_stage(write_plant(content, Path(directory, "monitor", "plant.yaml")))
    session.start_monitor(MONITOR)
    return change_s


def monitor_a_change(session, change_s, model, directory):
    """Track while a mode becomes faster, and accept the model that the monitor then offers.

    The stage was started, and the time of the change returned, by `start_changing_stage`.
    RuntimeError is raised if the monitor offers nothing.
    """
    session.wait_for_stage()
    session.let_monitor_follow()
    session.track(REFERENCE, model, CHANGING_S, directory / "changing")
    offer = offered_model(session.client, OFFER_TIMEOUT_S)
    if offer is None:
        raise RuntimeError(f"the monitor offered no model within {OFFER_TIMEOUT_S:g} s")
    worse = session.track(REFERENCE, model, COMPARED_S, directory / "before")
    accept_extended_model(session.client, model, offer.path)
    better = session.track(REFERENCE, model, COMPARED_S, directory / "after")
    accept_extended_model(session.client, model, "")
    return Monitored(change_s, offer.since_s, offer.sentence, offer.before_rms_um,
                     offer.after_rms_um, worse.e_rms_percent, better.e_rms_percent,
                     str(offer.path))


def decide_a_cause(session, plant, model, directory):
    """Scan a stage with a sensor lag, and decide with one recording what the model lacks."""
    directory.mkdir(parents=True, exist_ok=True)
    session.start_stage(write_plant(with_sensor_lag(plant, LAG_S), directory / "plant.yaml"))
    session.wait_for_stage()
    scanned = session.track(SCAN, model, SCAN_S, directory / "scan")
    result = session.decide(model, scanned.recording, directory / "diagnosis", LONGEST_S)
    verdict = json.loads(result.verdict_json)
    proposal = _proposal(directory / "diagnosis" / "experiment_1" / "next_experiment.json")
    before = {each["effects"]: each["probability"] for each in proposal.get("alternatives", [])}
    return Decided(
        f"a lag of the sensor of {1e3 * LAG_S:g} ms", proposal.get("description", ""),
        before or verdict["probabilities"], verdict["probabilities"], result.decision,
        result.sentence, result.report)


def _proposal(path):
    """Return the proposed experiment; empty if the first diagnosis was certain."""
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}


def second_part(session, plant, change_s, model, directory):
    """Run both parts with the extended model of the first; return their results for the summary.

    The results have the keys ``monitor``, None without a time of the change, and ``decision``.
    """
    watched = None if change_s is None else monitor_a_change(
        session, change_s, model, Path(directory, "monitor"))
    decided = decide_a_cause(session, plant, model, Path(directory, "decision"))
    return {"monitor": None if watched is None else asdict(watched), "decision": asdict(decided)}


SOURCE = "the demo: a change that is hidden from the model"


def with_faster_mode(plant, factor, begin_s):
    """Return a plant file's content whose last mode becomes faster by a factor at a stage time.

    It is None if the plant has no vibration mode.
    """
    content = _content(plant)
    modes = [number for number, entry in enumerate(content["stage"])
             if entry["effect"] == "vibration_mode"]
    if not modes:
        return None
    # Reduce the mass, as the stiffness would also change the compliance.
    content["stage"][modes[-1]] |= {
        "effect": "loaded_mode", "added_mass": _valued(factor**-2 - 1.0, "1"),
        "added_stiffness": _valued(0.0, "1"), "begin_s": _valued(begin_s, "s")}
    return content


def with_sensor_lag(plant, lag_s):
    """Return a plant file's content whose displacement passes a first-order lag at the sensor."""
    content = _content(plant)
    content["sensor"].insert(0, {
        "effect": "distributed_lag", "lag_s": _valued(lag_s, "s"), "sections": _valued(1, "1")})
    return content


def write_plant(content, path):
    """Write the content of a plant file, and its folder if it is missing; return its path."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    return path


def _content(plant):
    file = resources.files("piezo_sim") / PLANTS[plant] if plant in PLANTS else Path(plant)
    return yaml.safe_load(file.read_text(encoding="utf-8"))


def _valued(value, unit):
    return {"value": value, "unit": unit, "source": SOURCE}
