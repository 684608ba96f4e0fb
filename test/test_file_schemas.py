# SPDX-License-Identifier: BSD-3-Clause
"""Every kind of file, changed in every small way: what was accepted before the schemas still is.

``data/accepted_files.json`` names the changes that the former readers accepted, with a hash of what
they read. They refused all others.
"""

import copy
import dataclasses
import hashlib
import json
import math
import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from piezo_controller.feedback.controller_file import ControllerFileError, load_controller
from piezo_controller.feedback.synthesis.weights import WeightsError, load_weights
from piezo_controller.learning.learned_file import LearnedFileError, load_correction
from piezo_controller.references.reference import Reference
from piezo_models.model_document import ModelFileError, document_of
from piezo_models.model_file import load_model
from piezo_sim.plant.plant_effect import PlantConfigError
from piezo_sim.plant.plant_file import read_plant
from piezo_stage_driver.backends.calibration import CalibrationError, load_calibration

SOURCE = Path(__file__).parents[1] / "src"
ACCEPTED = json.loads((Path(__file__).parent / "data" / "accepted_files.json").read_text())
# The readers by hand let NumPy make numbers of texts and truth values, and took true for version 1.
STRICTER = re.compile(r"(version|[A-D]\.\d\.\d|correction_um\.\d): (true|false|number as text)")
STRICTER_KINDS = ("controller", "learned")
# A period of whole seconds is a number like any other.
# No data may have told a parameter; its standard deviation is then null.
MORE_LENIENT = {
    ("controller", "sample_period_s: one"), ("controller", "sample_period_s: two"),
    *(("model", f"uncertainties.creep.{name}_rad_per_s.{number}: null")
      for name in ("poles", "zeros") for number in (0, 1))}
LONG = bool(os.environ.get("LONG_TESTS"))
LONGEST_SENTENCE = 1000
REFERENCE = Reference("harmonic", (100.0,), (40.0,), (), 57.0)


@dataclass(frozen=True)
class Kind:
    """One kind of file.

    Attributes
    ----------
    document : dict
        A sound one.
    load : callable
        From a path to the content, as plain numbers, texts, lists and objects.
    refusal : type
        What `load` raises.
    write : callable
        From a document to the text of a file.
    """

    document: dict
    load: Any
    refusal: type
    write: Any


def model_document():
    return {
        "format": "piezo_stage_model", "version": 1, "created": "2026-01-02T03:04:05+00:00",
        "voltage_range_v": [-20.0, 120.0],
        "sample_periods_s": {"creep": 0.01, "dynamics": 25e-6},
        "errors": {"e_y_percent": 0.123, "unseen": {"rms_um": 0.5}},
        "recordings": [{"path": "runs/größe/creep", "sha256": "ab" * 32}],
        "creep": {"poles_rad_per_s": [0.1, 1.0], "zeros_rad_per_s": [0.11, 1.1]},
        "dynamics": {
            "time_constant_s": 5e-4, "mode_frequencies_rad_per_s": [900.0, 2000.0],
            "damping_ratios": [0.1, 0.2], "antiresonance_frequencies_rad_per_s": [700.0],
            "antiresonance_damping_ratios": [0.05]},
        "effects": [
            {"name": "delay", "parameters": {"delay_s": 1e-4}},
            {"name": "creep", "parameters": {
                "gains": [0.01, 0.02], "time_constants_s": [1.0, 10.0]}}],
        "uncertainties": {"creep": {
            "poles_rad_per_s": [0.01, 0.1], "zeros_rad_per_s": [0.01, 0.1]}},
        "hysteretic_creep": {
            "half_widths_v": [5.0, 20.0], "time_constants_s": [1.0, 10.0],
            "weights_um_per_v": [0.01, 0.02]},
        "visited": ["1", "01", "110"],
        "hysteresis": {
            "voltage_min_v": -20.0, "voltage_max_v": 120.0, "offset_um": -3.0,
            "reversible_um_per_v": [0.1, 0.0, 0.2],
            "density_um_per_v2": [[0.01], [0.02, 0.0], [0.01, 0.03, 0.02]]},
    }


def controller_document():
    return {
        "format": "piezo_stage_controller", "version": 1, "model_sha256": "0" * 64,
        "sample_period_s": 1e-3, "report": {"mu": 0.9, "verdict": "sound", "peaks": [1.0, 2.0]},
        "weights": {"sample_period_s": 1e-3}, "A": [[0.5, 0.0], [0.0, 0.9]],
        "B": [[1.0], [1.0]], "C": [[1.0, 1.0]], "D": [[0.0]]}


def learned_document():
    return {
        "format": "piezo_learned_feedforward", "version": 1,
        "reference": json.loads(json.dumps(dataclasses.asdict(REFERENCE))),
        "model_sha256": "abc", "sample_rate_hz": 40_000.0, "iterations": 6,
        "error_rms_um": 0.002, "correction_um": [-0.1, 0.0, 0.1]}


def weights_document():
    return yaml.safe_load((SOURCE / "piezo_controller/piezo_controller/weights.yaml").read_text())


def calibration_document():
    return yaml.safe_load(
        (SOURCE / "piezo_stage_driver/config/nidaqmx_calibration.yaml").read_text())


def plant_document():
    return yaml.safe_load((SOURCE / "piezo_sim/piezo_sim/plant.yaml").read_text())


def model_content(path):
    return document_of(load_model(path))


def controller_content(path):
    controller = load_controller(path)
    return {name: np.asarray(value).tolist() if name in "ABCD" else value
            for name, value in vars(controller).items()}


def learned_content(path):
    return load_correction(path, REFERENCE, "abc", 40_000.0).tolist()


def weights_content(path):
    return load_weights(path).model_dump()


def calibration_content(path):
    content = dict(vars(load_calibration(path)))
    assert content.pop("mark_lines") == ""  # an entry that came later
    return content


def plant_content(path):
    plant = read_plant(path)
    return {section: [[effect.name, dataclasses.asdict(effect)] for effect in effects]
            for section, effects in vars(plant).items()}


def as_json(document):
    return json.dumps(document).replace("Infinity", "1e999")


def as_yaml(document):
    return yaml.dump(document, Dumper=getattr(yaml, "CSafeDumper", yaml.SafeDumper))


KINDS = {
    "model": Kind(model_document(), model_content, ModelFileError, as_json),
    "controller": Kind(controller_document(), controller_content, ControllerFileError, as_json),
    "learned": Kind(learned_document(), learned_content, LearnedFileError, as_json),
    "weights": Kind(weights_document(), weights_content, WeightsError, as_yaml),
    "calibration": Kind(
        calibration_document(), calibration_content, CalibrationError, as_yaml),
    "plant": Kind(plant_document(), plant_content, PlantConfigError, as_yaml),
}

REPLACEMENTS = {
    "null": None, "true": True, "false": False, "text": "text", "number as text": "1.5",
    "empty text": "", "zero": 0, "minus one": -1, "one": 1, "two": 2, "one and a half": 1.5,
    "one as a float": 1.0, "two as a float": 2.0, "minus a half": -0.5, "very large": 1e300,
    "very small": 1e-300, "beyond a float": 10**400, "not a number": math.nan,
    "infinity": math.inf, "empty list": [], "empty object": {}, "list of a number": [1.0],
    "list of a text": ["x"], "list of a list": [[1.0]], "object of a number": {"x": 1.0},
}


def places(value, path=()):
    """Yield the path of every entry of a document; of a list the first and the last."""
    if isinstance(value, dict):
        entries = list(value.items())
    elif isinstance(value, list):
        entries = [(i, value[i]) for i in sorted({0, len(value) - 1} & set(range(len(value))))]
    else:
        return
    for name, entry in entries:
        yield (*path, name)
        yield from places(entry, (*path, name))


def changed(document, path, change):
    """Return a copy of a document with one change at a path, or None if that changes nothing."""
    copied = copy.deepcopy(document)
    owner = copied
    for name in path[:-1]:
        owner = owner[name]
    if change == "dropped":
        del owner[path[-1]]
    elif change == "an entry more":
        entry = owner[path[-1]]
        if isinstance(entry, dict):
            entry["surprise"] = 1
        elif isinstance(entry, list) and entry:
            entry.append(copy.deepcopy(entry[-1]))
        else:
            return None
    else:
        owner[path[-1]] = copy.deepcopy(REPLACEMENTS[change])
    return copied


def mutations(kind):
    """Yield (name, document) of every single change to the sound document of a kind."""
    document = KINDS[kind].document
    yield "as it is", document
    yield "an entry more", {**document, "surprise": 1}
    for path in places(document):
        for change in ("dropped", "an entry more", *REPLACEMENTS):
            mutated = changed(document, path, change)
            if mutated is not None:
                yield f"{'.'.join(map(str, path))}: {change}", mutated


def digest(content):
    """Return a short hash of the content of a file; 1 and 1.0 count as one."""
    def plain(value):
        if isinstance(value, dict):
            return {str(name): plain(entry) for name, entry in value.items()}
        if isinstance(value, (list, tuple)):
            return [plain(entry) for entry in value]
        if isinstance(value, (int, float)) and not isinstance(value, bool):
            return repr(float(value)) if abs(value) < 1e308 else "large"
        return repr(value)
    text = json.dumps(plain(content), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def read(kind, document, path):
    """Return the hash of what is read of a document, or the sentence that refuses it."""
    path.write_text(KINDS[kind].write(document))
    try:
        return digest(KINDS[kind].load(path)), ""
    except KINDS[kind].refusal as error:
        return None, str(error)


def assert_as_before(kind, name, document, path):
    found, sentence = read(kind, document, path)
    stricter = kind in STRICTER_KINDS and STRICTER.fullmatch(name)
    if (kind, name) in MORE_LENIENT:
        assert found and name not in ACCEPTED[kind]
    elif name in ACCEPTED[kind] and not stricter:
        assert found == ACCEPTED[kind][name], f"{name}: {sentence}"
    else:
        assert found is None, name
        assert len(sentence.splitlines()) == 1 and len(sentence) < LONGEST_SENTENCE
        assert path.name in sentence


@pytest.mark.parametrize("kind", KINDS)
def test_changed_document_is_read_or_refused_as_before(kind, tmp_path_factory):
    path = tmp_path_factory.mktemp(kind) / "file"
    every = dict(mutations(kind))
    assert ACCEPTED[kind].keys() <= every.keys()
    if LONG:
        for name, document in every.items():
            assert_as_before(kind, name, document, path)
        return

    @settings(max_examples=50)
    @given(st.sampled_from(sorted(every)))
    def one_change(name):
        assert_as_before(kind, name, every[name], path)

    assert_as_before(kind, "as it is", every["as it is"], path)
    one_change()


ANY = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(
        st.characters(codec="utf-8", exclude_categories=["C"]), max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(
        st.text("abc", max_size=3), inner, max_size=3), max_leaves=6)


@pytest.mark.parametrize("kind", KINDS)
def test_several_wild_changes_are_read_or_refused_in_one_sentence(kind, tmp_path_factory):
    path = tmp_path_factory.mktemp(kind) / "file"
    document = KINDS[kind].document
    everywhere = sorted(places(document), key=str)

    @settings(max_examples=500 if LONG else 40)
    @given(st.lists(st.tuples(st.sampled_from(everywhere), ANY), min_size=1, max_size=3))
    def wild(changes):
        copied = copy.deepcopy(document)
        for place, value in changes:
            owner = copied
            try:
                for name in place[:-1]:
                    owner = owner[name]
                owner[place[-1]] = value
            except (KeyError, IndexError, TypeError):
                continue  # an earlier change took the place away
        found, sentence = read(kind, copied, path)
        assert found or (len(sentence.splitlines()) == 1 and len(sentence) < LONGEST_SENTENCE)

    wild()
