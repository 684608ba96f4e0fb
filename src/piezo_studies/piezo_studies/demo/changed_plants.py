# SPDX-License-Identifier: BSD-3-Clause
"""Plant files of the demo's stage with changes that are unknown to the model."""

from importlib import resources
from pathlib import Path

import yaml

from piezo_sim.plant.named_plants import PLANTS

SOURCE = "the demo: a change that is hidden from the model"


def with_faster_mode(plant, factor, begin_s):
    """Return a plant whose last vibration mode becomes faster while it runs.

    Parameters
    ----------
    plant : str
        Name of a plant that comes with the simulator, or path of a plant file.
    factor : float
        Ratio of the frequencies after and before the change.
    begin_s : float
        Stage time of the change.

    Returns
    -------
    dict or None
        Content of a plant file; None if the plant has no such mode.
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
    """Return a plant whose displacement passes a first-order low-pass before it is measured.

    Parameters
    ----------
    plant : str
        Name of a plant that comes with the simulator, or path of a plant file.

    Returns
    -------
    dict
        Content of a plant file.
    """
    content = _content(plant)
    content["sensor"].insert(0, {
        "effect": "distributed_lag", "lag_s": _valued(lag_s, "s"), "sections": _valued(1, "1")})
    return content


def write_plant(content, path):
    """Write the content of a plant file; return its path.

    Parameters
    ----------
    path : Path
        Path of the file; its folder is created if it is missing.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    return path


def _content(plant):
    file = resources.files("piezo_sim") / PLANTS[plant] if plant in PLANTS else Path(plant)
    return yaml.safe_load(file.read_text(encoding="utf-8"))


def _valued(value, unit):
    return {"value": value, "unit": unit, "source": SOURCE}
