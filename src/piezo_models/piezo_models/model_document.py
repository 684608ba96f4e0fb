# SPDX-License-Identifier: BSD-3-Clause
"""The JSON document of a model file, as it is written."""

import json
import math

import numpy as np

FORMAT = "piezo_stage_model"
VERSION = 1


class ModelFileError(ValueError):
    """A model file that cannot be read or written: says path, field and cure."""


def document_of(identified):
    """Return the document of an `IdentifiedModel`: objects, lists, text and plain numbers."""
    model = identified.model
    hysteresis, dynamics = model.hysteresis, model.dynamics
    density = hysteresis.density_um_per_v2
    effects = [
        {"name": effect.name, "parameters": _plain(effect.parameters())}
        for effect in model.effects
    ]
    uncertainties = (
        {"uncertainties": _untold_as_null(_plain(identified.uncertainties))}
        if identified.uncertainties else {}
    )
    visited = {} if identified.visited is None else {"visited": [
        "".join("01"[int(cell)] for cell in row[: i + 1])
        for i, row in enumerate(identified.visited)
    ]}
    reversible = hysteresis.reversible_um_per_v
    hysteretic = model.hysteretic_creep
    hysteretic_creep = {} if hysteretic is None else {
        "hysteretic_creep": {
            "half_widths_v": list(hysteretic.half_widths_v),
            "time_constants_s": list(hysteretic.time_constants_s),
            "weights_um_per_v": list(hysteretic.weights_um_per_v),
        }
    }
    return {
        "format": FORMAT,
        "version": VERSION,
        "created": identified.created,
        "voltage_range_v": [float(voltage) for voltage in identified.voltage_range_v],
        "sample_periods_s": _plain(identified.sample_periods_s),
        "errors": _plain(identified.errors),
        "recordings": list(identified.recordings),
        "creep": {
            "poles_rad_per_s": list(model.creep.poles_rad_per_s),
            "zeros_rad_per_s": list(model.creep.zeros_rad_per_s),
        },
        "dynamics": {
            "time_constant_s": dynamics.time_constant_s,
            "mode_frequencies_rad_per_s": list(dynamics.mode_frequencies_rad_per_s),
            "damping_ratios": list(dynamics.damping_ratios),
            "antiresonance_frequencies_rad_per_s": list(
                dynamics.antiresonance_frequencies_rad_per_s
            ),
            "antiresonance_damping_ratios": list(dynamics.antiresonance_damping_ratios),
        },
        **({"effects": effects} if effects else {}),
        **uncertainties,
        **hysteretic_creep,
        **visited,
        "hysteresis": {
            "voltage_min_v": hysteresis.voltage_min_v,
            "voltage_max_v": hysteresis.voltage_max_v,
            "offset_um": hysteresis.offset_um,
            **({"reversible_um_per_v": reversible.tolist()} if reversible.any() else {}),
            "density_um_per_v2": [row[: i + 1].tolist() for i, row in enumerate(density)],
        },
    }


def _plain(value):
    """Numbers of NumPy as plain ones and tuples as lists, in dicts of any depth."""
    if isinstance(value, dict):
        return {str(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(entry) for entry in value]
    return value.item() if isinstance(value, np.generic) else value


def _untold_as_null(value):
    """Standard deviations with null for infinite ones, as JSON has no infinity."""
    if isinstance(value, dict):
        return {key: _untold_as_null(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [_untold_as_null(entry) for entry in value]
    return None if value == math.inf else value


def rendered(value, indent=""):
    """Return a document as JSON with one line per field, and per row of a matrix."""
    inner = indent + "  "
    if isinstance(value, dict) and value:
        fields = [f"{inner}{json.dumps(key)}: {rendered(v, inner)}" for key, v in value.items()]
        return "{\n" + ",\n".join(fields) + "\n" + indent + "}"
    if isinstance(value, list) and any(isinstance(entry, (list, dict)) for entry in value):
        entries = [f"{inner}{rendered(entry, inner)}" for entry in value]
        return "[\n" + ",\n".join(entries) + "\n" + indent + "]"
    return json.dumps(value, allow_nan=False)
