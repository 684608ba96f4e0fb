# SPDX-License-Identifier: BSD-3-Clause
"""Types of the fields of a file: finite numbers with unit and range, parts and whole documents."""

from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag, model_validator
from pydantic_core import PydanticCustomError
from typing_extensions import TypeAliasType

HIDDEN = "\0"
"""Begins the name of an alternative of a type; such a name is no part of the path of a field."""

_NUMBER, _LIST, _OBJECT = HIDDEN + "number", HIDDEN + "list", HIDDEN + "object"

VIOLATION = "violation"
"""Type of the errors that `violation` makes."""

Number = float
"""A finite number; a whole one is a number, too. A text or a truth value is none."""

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
    """Return what a validator of a part raises when its fields contradict each other.

    Parameters
    ----------
    problem, cure : str
        What is wrong, as the end of a sentence that begins with the field; what to do.
    field : str
        Path inside the part; empty for the part as a whole.
    """
    return PydanticCustomError(VIOLATION, "{problem}", {
        "problem": problem, "cure": cure, "field": field})


class Part(BaseModel):
    """An object of a file: it has its fields and no others, each of its own type."""

    model_config = ConfigDict(
        strict=True, extra="forbid", frozen=True, allow_inf_nan=False, protected_namespaces=())

    @model_validator(mode="before")
    @classmethod
    def _refuse_null(cls, content: Any) -> Any:
        """Refuse null where a field may only be left out."""
        for name, field in cls.model_fields.items():
            optional = field.default is None and field.annotation is not Any
            if optional and isinstance(content, dict) and content.get(name, content) is None:
                raise violation("is null", "give it, or leave the field out", name)
        return content


class Document(Part):
    """The whole of a file.

    Attributes
    ----------
    TITLE : str
        What a sentence calls such a file, such as "model file".
    FORMAT : str
        What the entry ``format`` of the file says; empty for a file without one.
    VERSION : int
        What the entry ``version`` says; 0 for a file without one.
    SYNTAX : str
        ``json`` or ``yaml``.
    RENEW : str
        What to do with a file of another version, or one that is damaged.
    """

    TITLE: ClassVar[str]
    FORMAT: ClassVar[str] = ""
    VERSION: ClassVar[int] = 0
    SYNTAX: ClassVar[str] = "json"
    RENEW: ClassVar[str] = "correct the file"


def entry(meaning: str, *, unit: str = "", default: Any = ..., above: float | None = None,
          at_least: float | None = None, at_most: float | None = None,
          below: float | None = None, shortest: int | None = None,
          longest: int | None = None) -> Any:
    """Declare a field of a part: what it means, its unit and its range.

    Parameters
    ----------
    meaning : str
        For the table of the fields in the documentation.
    unit : str
        Of a number, and of each number of a list.
    default : object, optional
        Makes the field optional.
    above, at_least, at_most, below : float, optional
        Range of a number.
    shortest, longest : int, optional
        Range of the length of a list.
    """
    return Field(default, description=meaning, json_schema_extra={"unit": unit}, gt=above,
                 ge=at_least, le=at_most, lt=below, min_length=shortest, max_length=longest)
