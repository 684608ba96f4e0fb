# SPDX-License-Identifier: BSD-3-Clause
"""The strict reader of a model file's document."""

import json
import math

import numpy as np

from piezo_models.cascade import StageModel
from piezo_models.effects import known_effects
from piezo_models.hysteresis.hysteretic_creep import HystereticCreep
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.identified_model import IdentifiedModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_models.model_document import FORMAT, VERSION, ModelFileError


def identified_model_of(document, path):
    """Return the model that a document tells, checked field by field.

    Parameters
    ----------
    document : dict
        See `model_document.document_of`.
    path : path-like
        Named in refusals.

    Returns
    -------
    IdentifiedModel

    Raises
    ------
    ModelFileError
        If the document is not of this version, or has a missing, unknown or invalid field.
    """
    return _Reader(path).identified_model(document)


class _Reader:
    """Checks a document field by field; each refusal names the path, the field and the cure."""

    def __init__(self, path):
        self.path = path

    def refuse(self, name, problem, cure):
        raise ModelFileError(f"{self.path}: {name} {problem}; {cure}")

    def identified_model(self, document):
        if not isinstance(document, dict) or document.get("format") != FORMAT:
            self.refuse("format", f'is not "{FORMAT}"', "give a model file")
        if document.get("version") != VERSION or isinstance(document["version"], bool):
            self.refuse(
                "version",
                f"is {json.dumps(document.get('version'))[:40]}, not {VERSION}",
                "identify the model again with this release",
            )
        top = self.fields(
            document,
            "",
            "format",
            "version",
            "created",
            "voltage_range_v",
            "sample_periods_s",
            "errors",
            "recordings",
            "creep",
            "dynamics",
            "hysteresis",
            optional=("effects", "hysteretic_creep", "uncertainties", "visited"),
        )
        low, high = self.numbers(top["voltage_range_v"], "voltage_range_v", length=2)
        if not low < high:
            self.refuse("voltage_range_v", "does not increase", "give [lowest, highest]")
        if not isinstance(top["created"], str):
            self.refuse("created", "is not text", "give an ISO 8601 time")
        periods = self.number_tree(top["sample_periods_s"], "sample_periods_s")
        for name, period in periods.items():
            if isinstance(period, dict) or period <= 0:
                self.refuse(f"sample_periods_s.{name}", "is not positive", "give a time in s")
        return IdentifiedModel(
            model=StageModel(
                self.hysteresis(top["hysteresis"]),
                self.creep(top["creep"]),
                self.dynamics(top["dynamics"]),
                self.hysteretic_creep(top),
                self.effects(top.get("effects", [])),
            ),
            voltage_range_v=(low, high),
            sample_periods_s=periods,
            errors=self.number_tree(top["errors"], "errors"),
            recordings=self.recordings(top["recordings"]),
            created=top["created"],
            uncertainties=self.uncertainties(top),
            visited=self.visited(top),
        )

    def visited(self, top):
        if "visited" not in top:
            return None
        rows = top["visited"]
        size = len(top["hysteresis"]["density_um_per_v2"])
        right = isinstance(rows, list) and len(rows) == size and all(
            isinstance(row, str) and len(row) == i + 1 and set(row) <= {"0", "1"}
            for i, row in enumerate(rows)
        )
        if not right:
            self.refuse("visited", "is no triangle of 0 and 1 like the density", "give row i with "
                        "a 1 for each of its i + 1 cells that was visited, or leave the field out")
        return np.array([[cell == "1" for cell in row.ljust(size, "0")] for row in rows])

    def uncertainties(self, top):
        """Standard deviations of each part, in the shape of its parameters."""
        if "uncertainties" not in top:
            return {}
        parts = self.fields(top["uncertainties"], "uncertainties.", optional=("creep", "dynamics"))
        read = {}
        for part, deviations in parts.items():
            names = tuple(top[part])
            fields = self.fields(deviations, f"uncertainties.{part}.", *names)
            read[part] = {
                name: self.deviations(deviation, f"uncertainties.{part}.{name}", top[part][name])
                for name, deviation in fields.items()}
        return read

    def deviations(self, value, path, parameter):
        """Standard deviations in the shape of a parameter; null is one that no data told."""
        if not isinstance(parameter, list):
            return self.deviation(value, path)
        if not isinstance(value, list) or len(value) != len(parameter):
            self.numbers(value, path, length=len(parameter))
        return [self.deviation(entry, f"{path}[{i}]") for i, entry in enumerate(value)]

    def deviation(self, value, path):
        number = math.inf if value is None else self.number(value, path)
        if number < 0.0:
            self.refuse(path, "is negative", "give standard deviations")
        return number

    def hysteresis(self, value):
        fields = self.fields(
            value, "hysteresis.", "voltage_min_v", "voltage_max_v", "offset_um",
            "density_um_per_v2", optional=("reversible_um_per_v",),
        )
        name = "hysteresis.density_um_per_v2"
        rows = fields["density_um_per_v2"]
        if not isinstance(rows, list) or not rows:
            self.refuse(name, "is not a list of rows", "give row i with its i + 1 cells")
        density = np.zeros((len(rows), len(rows)))
        for i, row in enumerate(rows):
            density[i, : i + 1] = self.numbers(row, f"{name}[{i}]", length=i + 1)
            if (density[i] < 0).any():
                self.refuse(f"{name}[{i}]", "holds a negative cell", "fit a non-negative density")
        return self.built(
            PreisachModel,
            "hysteresis",
            self.number(fields["voltage_min_v"], "hysteresis.voltage_min_v"),
            self.number(fields["voltage_max_v"], "hysteresis.voltage_max_v"),
            density,
            self.number(fields["offset_um"], "hysteresis.offset_um"),
            self.reversible(fields, len(rows)),
        )

    def reversible(self, fields, length):
        if "reversible_um_per_v" not in fields:
            return None
        name = "hysteresis.reversible_um_per_v"
        values = self.numbers(fields["reversible_um_per_v"], name, length=length)
        if min(values) < 0.0:
            self.refuse(name, "holds a negative number", "fit a non-negative density")
        return values

    def creep(self, value):
        names = ("poles_rad_per_s", "zeros_rad_per_s")
        fields = self.fields(value, "creep.", *names)
        return self.built(
            CreepDynamics, "creep", *(self.numbers(fields[name], f"creep.{name}") for name in names)
        )

    def dynamics(self, value):
        names = (
            "mode_frequencies_rad_per_s",
            "damping_ratios",
            "antiresonance_frequencies_rad_per_s",
            "antiresonance_damping_ratios",
        )
        fields = self.fields(value, "dynamics.", "time_constant_s", *names)
        return self.built(
            ElectricVibrationDynamics,
            "dynamics",
            self.number(fields["time_constant_s"], "dynamics.time_constant_s"),
            *(self.numbers(fields[name], f"dynamics.{name}") for name in names),
        )

    def hysteretic_creep(self, top):
        if "hysteretic_creep" not in top:
            return None
        names = ("half_widths_v", "time_constants_s", "weights_um_per_v")
        fields = self.fields(top["hysteretic_creep"], "hysteretic_creep.", *names)
        return self.built(
            HystereticCreep, "hysteretic_creep",
            *(self.numbers(fields[name], f"hysteretic_creep.{name}") for name in names),
        )

    def effects(self, value):
        if not isinstance(value, list):
            self.refuse("effects", "is not a list", "give the name and parameters of each")
        known, effects = known_effects(), []
        for i, entry in enumerate(value):
            path = f"effects[{i}]"
            fields = self.fields(entry, f"{path}.", "name", "parameters")
            if fields["name"] not in known:
                self.refuse(f"{path}.name", "is no effect that is installed here",
                            f"install it, or give one of {', '.join(known)}")
            kind = known[fields["name"]]
            parameters = self.fields(fields["parameters"], f"{path}.parameters.", *kind.units())
            effects.append(self.built(kind, path, **{
                name: self.numbers(number, f"{path}.parameters.{name}")
                if isinstance(number, list)
                else self.number(number, f"{path}.parameters.{name}")
                for name, number in parameters.items()
            }))
        return tuple(effects)

    def recordings(self, value):
        if not isinstance(value, list):
            self.refuse("recordings", "is not a list", "give path and sha256 of each recording")
        for i, recording in enumerate(value):
            fields = self.fields(recording, f"recordings[{i}].", "path", "sha256")
            if not all(isinstance(entry, str) for entry in fields.values()):
                self.refuse(f"recordings[{i}]", "is not text", "give path and sha256 as text")
        return value

    def built(self, kind, name, *arguments, **named):
        try:
            return kind(*arguments, **named)
        except ValueError as error:
            raise ModelFileError(f"{self.path}: {name}: {error}") from error

    def fields(self, value, prefix, *names, optional=()):
        """The object itself, once it has exactly these fields, and optional ones or not."""
        if not isinstance(value, dict):
            self.refuse(prefix.rstrip("."), "is not an object", "save the model again")
        for name in names:
            if name not in value:
                self.refuse(f"{prefix}{name}", "is missing", "save the model again")
        for name in value:
            if name not in (*names, *optional):
                self.refuse(f"{prefix}{name}", "is unknown to this version", "remove it")
        return value

    def number(self, value, name):
        if isinstance(value, (int, float)) and not isinstance(value, bool):
            try:
                number = float(value)
            except OverflowError:
                number = math.inf
            if math.isfinite(number):
                return number
        self.refuse(name, "is not a finite number", "give a finite number")

    def numbers(self, value, name, length=None):
        if not isinstance(value, list) or (length is not None and len(value) != length):
            count = "numbers" if length is None else f"{length} numbers"
            self.refuse(name, f"is not a list of {count}", f"give {count}")
        return [self.number(entry, f"{name}[{i}]") for i, entry in enumerate(value)]

    def number_tree(self, value, name):
        """Finite numbers by name, in objects of any depth."""
        if not isinstance(value, dict):
            self.refuse(name, "is not an object", "give numbers by name")
        return {
            key: self.number_tree(entry, f"{name}.{key}")
            if isinstance(entry, dict)
            else self.number(entry, f"{name}.{key}")
            for key, entry in value.items()
        }
