# SPDX-License-Identifier: BSD-3-Clause
"""Types of the fields of a file: finite numbers with unit and range, parts, documents."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag, model_validator
from pydantic_core import PydanticCustomError
from typing_extensions import TypeAliasType

HIDDEN = "\0"
"""Prefix of the name of an alternative of a type, which is not part of a field's path."""

_NUMBER, _LIST, _OBJECT = HIDDEN + "number", HIDDEN + "list", HIDDEN + "object"

VIOLATION = "violation"
"""Error type of `violation`."""

Number = float
"""A finite number, integers included. Texts and booleans are rejected."""

Numbers = list[Number]
"""A list of finite numbers."""

Positive = Annotated[Number, Field(gt=0.0)]
"""A finite number above 0."""

NotNegative = Annotated[Number, Field(ge=0.0)]
"""A finite number from 0."""

NumberOrNumbers = Annotated[
    Annotated[Number, Tag(_NUMBER)] | Annotated[Numbers, Tag(_LIST)],
    Discriminator(lambda value: _LIST if isinstance(value, (list, tuple)) else _NUMBER)]
"""A finite number, or a list of them."""

if TYPE_CHECKING:
    NumberTree = dict[str, Any]
else:
    NumberTree = TypeAliasType("NumberTree", dict[str, Annotated[
        Annotated[Number, Tag(_NUMBER)] | Annotated["NumberTree", Tag(_OBJECT)],
        Discriminator(lambda value: _OBJECT if isinstance(value, dict) else _NUMBER)]])
"""Finite numbers by name, in objects of any depth."""


def violation(problem: str, cure: str, field: str = "") -> PydanticCustomError:
    """Return the error that a validator of a part raises for contradicting fields.

    The problem is the end of a sentence that begins with the path of the field in the part, which
    is empty for the whole part; the cure is the remedy.
    """
    return PydanticCustomError(VIOLATION, "{problem}", {
        "problem": problem, "cure": cure, "field": field})


def require_matrices(part: BaseModel, shapes: Mapping[str, tuple[int, int]], cure: str) -> None:
    """Raise a violation unless fields hold matrices of these rows and columns, by field."""
    for name, (rows, columns) in shapes.items():
        matrix = getattr(part, name)
        if len(matrix) != rows or any(len(row) != columns for row in matrix):
            raise violation(f"is not a {rows} x {columns} matrix", cure, name)


class Part(BaseModel):
    """An object of a file with exactly its fields, each of its type."""

    model_config = ConfigDict(
        strict=True, extra="forbid", frozen=True, allow_inf_nan=False, protected_namespaces=())

    @model_validator(mode="before")
    @classmethod
    def _refuse_null(cls, content: Any) -> Any:
        """Reject null for an optional field, which must be omitted instead."""
        for name, field in cls.model_fields.items():
            optional = field.default is None and field.annotation is not Any
            if optional and isinstance(content, dict) and content.get(name, content) is None:
                raise violation("is null", "give it, or leave the field out", name)
        return content


class Document(Part):
    """The content of a whole file.

    Attributes
    ----------
    TITLE : str
        Name of such a file in messages, for example "model file".
    FORMAT : str
        Value of the entry ``format``; empty for a file without one.
    VERSION : int
        Value of the entry ``version``; 0 for a file without one.
    SYNTAX : str
        ``json`` or ``yaml``.
    RENEW : str
        Remedy for a file of another version, or a damaged one.
    """

    TITLE: ClassVar[str]
    FORMAT: ClassVar[str] = ""
    VERSION: ClassVar[int] = 0
    SYNTAX: ClassVar[str] = "json"
    RENEW: ClassVar[str] = "correct the file"


def entry(meaning: str, *, unit: str = "", default: Any = ..., above: float | None = None,
          at_least: float | None = None, at_most: float | None = None,
          shortest: int | None = None, longest: int | None = None) -> Any:
    """Declare a field of a part with its meaning, unit and range.

    The meaning is for the table of fields in the documentation. The unit and the range are those of
    the number, or of each number of a list, whose length has a range as well. A default makes the
    field optional.
    """
    return Field(default, description=meaning, json_schema_extra={"unit": unit}, gt=above,
                 ge=at_least, le=at_most, min_length=shortest, max_length=longest)
