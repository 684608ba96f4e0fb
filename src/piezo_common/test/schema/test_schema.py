# SPDX-License-Identifier: BSD-3-Clause
import math
from typing import ClassVar

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from pydantic import model_validator

from piezo_common.schema import (
    Document,
    Number,
    NumberOrNumbers,
    Numbers,
    NumberTree,
    Part,
    SchemaError,
    checked,
    entry,
    load_document,
    parsed,
    violation,
)


class Range(Part):
    low_v: Number = entry("Lowest voltage.", unit="V")
    high_v: Number = entry("Highest voltage.", unit="V")

    @model_validator(mode="after")
    def _check_order(self):
        if self.low_v >= self.high_v:
            raise violation("is not below high_v", "exchange them", "low_v")
        return self


class Amplifier(Document):
    TITLE: ClassVar = "amplifier file"
    FORMAT: ClassVar = "amplifier"
    VERSION: ClassVar = 3
    RENEW: ClassVar = "write it again"

    format: str
    version: Number
    gain: Number = entry("Gain.", above=0.0)
    range: Range
    steps: Numbers = entry("Steps.", unit="V", default=[], longest=3)
    bits: int = entry("Of the converter.", default=16, at_least=1, at_most=32)
    errors: NumberTree = entry("Errors by name.", default={})
    lag_s: NumberOrNumbers = entry("Lags.", unit="s", default=0.0)
    rows: list[Numbers] = entry("Rows.", default=[])


SOUND = {"format": "amplifier", "version": 3, "gain": 2, "range": {"low_v": 0, "high_v": 1.5}}


def test_sound_content_becomes_numbers():
    amplifier = checked(Amplifier, {**SOUND, "errors": {"a": {"b": 1}}, "lag_s": [1, 2.0]})
    assert amplifier.gain == 2.0 and isinstance(amplifier.gain, float)
    assert amplifier.errors == {"a": {"b": 1.0}}
    assert amplifier.lag_s == [1.0, 2.0]


@pytest.mark.parametrize(("change", "sentence"), [
    ({"format": "other"}, 'format is "other", not "amplifier"; give a amplifier file'),
    ({"version": 4}, "version is 4, not 3; write it again"),
    ({"version": True}, "version is true, not 3; write it again"),
    ({"version": None}, "version is null, not 3; write it again"),
    ({"gain": 0.0}, "gain is out of range (found 0.0); give a number above 0"),
    ({"gain": "2"}, 'gain is not a finite number (found "2"); give a finite number'),
    ({"gain": True}, "gain is not a finite number (found true); give a finite number"),
    ({"gain": math.nan}, "gain is not a finite number (found NaN); give a finite number"),
    ({"gain": 10**400}, f"gain is not a finite number (found {10**39} ...); give a finite number"),
    ({"range": {"low_v": 0}}, "range.high_v is missing; write it again"),
    ({"range": {"low_v": 2, "high_v": 1}}, "range.low_v is not below high_v; exchange them"),
    ({"range": 3}, "range is not an object (found 3); give an object"),
    ({"surprise": 1}, "surprise is unknown to this version; remove it"),
    ({"steps": [1, 2, None]}, "steps[2] is not a finite number (found null); give a finite number"),
    ({"steps": {}}, "steps is not a list (found {}); give a list"),
    ({"steps": [1, 2, 3, 4]}, "steps has more than 3 entries; give no more"),
    ({"bits": 1.5}, "bits is not a whole number (found 1.5); give a whole number"),
    ({"bits": 33}, "bits is out of range (found 33); give a number up to 32"),
    ({"errors": {"a": {"b": "x"}}},
     'errors.a.b is not a finite number (found "x"); give a finite number'),
    ({"lag_s": [0.1, "x"]}, 'lag_s[1] is not a finite number (found "x"); give a finite number'),
    ({"rows": [[1], [1, "x"]]},
     'rows[1][1] is not a finite number (found "x"); give a finite number'),
])
def test_refusal_says_where_what_was_found_and_what_to_do(change, sentence):
    with pytest.raises(SchemaError) as refusal:
        checked(Amplifier, {**SOUND, **change})
    assert str(refusal.value) == sentence


@pytest.mark.parametrize(("text", "problem"), [
    ("", "is not valid JSON"), ("{", "is not valid JSON"), ("[" * 100_000, "is not valid JSON"),
    ("1" * 5000, "is not valid JSON"), ('{"a": 1, "a": 1}', "field a is repeated"),
    ("[1]", "format is [1]"), ("null", "format is null"),
])
def test_text_that_is_no_such_document_is_refused(text, problem):
    with pytest.raises(SchemaError, match="give a amplifier file") as refusal:
        parsed(Amplifier, text)
    assert problem in str(refusal.value)


def test_yaml_is_refused_like_json():
    class Settings(Document):
        TITLE: ClassVar = "settings file"
        SYNTAX: ClassVar = "yaml"
        gain: Number

    assert parsed(Settings, "gain: 2").gain == 2.0
    for text in ("gain: [", "gain: 2001-99-99", "\t"):
        with pytest.raises(SchemaError, match="is not valid YAML"):
            parsed(Settings, text)
    with pytest.raises(SchemaError, match="gain is not a finite number"):
        parsed(Settings, "gain: .nan")
    with pytest.raises(SchemaError, match="the content is not an object"):
        parsed(Settings, "3")


def test_file_that_cannot_be_read_is_refused(tmp_path):
    with pytest.raises(SchemaError, match="cannot be read .*; give a amplifier file"):
        load_document(Amplifier, tmp_path / "none.json")


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(
        st.text(max_size=5), inner, max_size=3), max_leaves=8)


@given(st.dictionaries(st.sampled_from([*Amplifier.model_fields, "other"]), VALUES, max_size=4))
@example({"errors": {"\r": None}})
def test_any_content_is_accepted_or_refused_in_one_sentence(changes):
    try:
        checked(Amplifier, {**SOUND, **changes})
    except SchemaError as error:
        assert len(str(error).splitlines()) == 1
        assert "; " in str(error)
