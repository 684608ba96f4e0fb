# SPDX-License-Identifier: BSD-3-Clause
"""Plant files of the demo's stage with changes that are unknown to the model."""

from importlib import resources
from pathlib import Path

import yaml

from piezo_sim.plant.named_plants import PLANTS

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
