# SPDX-License-Identifier: BSD-3-Clause
import json

import numpy as np
import pytest

from piezo_controller.learning.learned_file import (
    LearnedFileError,
    find_like,
    learned_path,
    load_correction,
    save_learned,
)
from piezo_controller.references.reference import Reference

REFERENCE = Reference("harmonic", (100.0,), (40.0,), (), 57.0)
SAME = REFERENCE, "abc", 40_000.0


@pytest.fixture
def path(tmp_path):
    path = learned_path(tmp_path / "new", REFERENCE, "abc")
    save_learned(path, *SAME, np.linspace(-0.1, 0.1, 400), 0.002, 6)
    return path


def test_correction_comes_back_to_the_bit(path):
    np.testing.assert_array_equal(load_correction(path, *SAME), np.linspace(-0.1, 0.1, 400))
    assert not list(path.parent.glob("*.tmp"))


def test_each_reference_and_model_has_a_file_of_its_own(tmp_path):
    other = Reference("harmonic", (100.0,), (41.0,), (), 57.0)
    paths = {learned_path(tmp_path, REFERENCE, "abc"), learned_path(tmp_path, other, "abc"),
             learned_path(tmp_path, REFERENCE, "abd")}
    assert len(paths) == 3


@pytest.mark.parametrize(("change", "sentence"), [
    ({"version": 2}, "version is 2, not 1"),
    ({"format": "other"}, 'format is "other", not'),
    ({"model_sha256": "abd"}, "was learned with another model_sha256"),
    ({"sample_rate_hz": 20_000.0}, "was learned with another sample_rate_hz"),
    ({"reference": {}}, "was learned with another reference"),
    ({"correction_um": ["x"]}, r"correction_um\[0\] is not a finite number"),
    ({"correction_um": []}, "correction_um has 0 entries"),
])
def test_file_that_does_not_fit_is_refused_in_one_sentence(path, change, sentence):
    path.write_text(json.dumps({**json.loads(path.read_text()), **change}))
    with pytest.raises(LearnedFileError, match=sentence) as refusal:
        load_correction(path, *SAME)
    assert "\n" not in str(refusal.value)
    assert "learn again" in str(refusal.value)


def test_file_that_is_no_json_or_not_there_is_refused(path):
    path.write_text("{")
    with pytest.raises(LearnedFileError, match="is not valid JSON"):
        load_correction(path, *SAME)
    with pytest.raises(LearnedFileError, match="No such file"):
        load_correction(path.with_name("none.json"), *SAME)


def test_nearest_like_reference_is_found_and_its_correction_grows_with_the_amplitude(path):
    save_learned(
        path.with_name("learned_far.json"), Reference("harmonic", (100.0,), (24.0,), (), 57.0),
        *SAME[1:], np.ones(400), 0.002, 6)
    wanted = Reference("harmonic", (100.0,), (44.0,), (), 55.0)
    found, correction_um = find_like(path.parent, wanted, *SAME[1:])
    assert found == path
    np.testing.assert_allclose(correction_um, 1.1 * np.linspace(-0.1, 0.1, 400))


@pytest.mark.parametrize("wanted", [
    (Reference("harmonic", (100.0,), (81.0,), (), 57.0), "abc", 40_000.0),
    (Reference("harmonic", (101.0,), (40.0,), (), 57.0), "abc", 40_000.0),
    (Reference("triangle", (100.0,), (40.0,), (), 57.0), "abc", 40_000.0),
    (Reference("multi_frequency", (100.0, 200.0), (40.0, 5.0)), "abc", 40_000.0),
    (REFERENCE, "abd", 40_000.0), (REFERENCE, "abc", 20_000.0)])
def test_what_is_not_alike_is_not_found(path, wanted):
    (path.parent / "learned_broken.json").write_text("{")
    assert find_like(path.parent, *wanted) is None


def test_an_earlier_version_that_is_kept_is_not_found(path):
    save_learned(path, *SAME, np.zeros(400), 0.001, 9)
    path.unlink()
    assert len(list(path.parent.iterdir())) == 1
    assert find_like(path.parent, *SAME) is None
