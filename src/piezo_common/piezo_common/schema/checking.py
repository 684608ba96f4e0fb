# SPDX-License-Identifier: BSD-3-Clause
"""Check content against its schema; errors say where, what was found, and what to do."""

import json
from collections.abc import Mapping
from typing import Any, TypeVar

from pydantic import ValidationError

from piezo_common.schema.fields import HIDDEN, VIOLATION, Part

LONGEST_FOUND = 40
"""Maximum length of a value quoted in a message, in characters."""

KINDS_OF_VALUE = {
    "float_type": "a finite number", "finite_number": "a finite number",
    "int_type": "a whole number", "int_from_float": "a whole number",
    "string_type": "a text", "bool_type": "true or false", "list_type": "a list",
    "dict_type": "an object", "model_type": "an object", "model_attributes_type": "an object",
}
"""Expected kind of value, by pydantic's type of the error."""

P = TypeVar("P", bound=Part)


class SchemaError(ValueError):
    """Content that does not fit its schema: the `problem`, with its field, and the `cure`."""

    def __init__(self, problem: str, cure: str) -> None:
        super().__init__(f"{problem}; {cure}")
        self.problem, self.cure = problem, cure


def check(kind: type[P], content: object, where: str = "", renew: str = "correct the file") -> P:
    """Check content, as a parser of JSON or YAML returns it, against a class of parts.

    Raises `SchemaError` if a field is missing, unknown, of a wrong type or out of range. The
    content is at a path in its file, empty for the whole; `renew` is the remedy for a missing or
    unknown field.
    """
    try:
        return kind.model_validate(content)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
    raise SchemaError(*_problem_and_cure(first, where, renew)) from None


def _problem_and_cure(error: Mapping[str, Any], where: str, renew: str) -> tuple[str, str]:
    context = error.get("ctx", {})
    if error["type"] == VIOLATION:
        path = path_of(error["loc"], where)
        inner = printable(context["field"])
        path = f"{path}.{inner}" if path and inner else path + inner
        return f"{path or 'the content'} {context['problem']}", context["cure"]
    path = path_of(error["loc"], where) or "the content"
    problem, cure = _problem(error["type"], context, error["input"], renew)
    return f"{path} {problem}", cure


def _problem(kind: str, context: Mapping[str, Any], found: object, renew: str) -> tuple[str, str]:
    """Return problem and remedy of a field for an error of pydantic."""
    if kind == "missing":
        return "is missing", renew
    if kind == "extra_forbidden":
        return "is unknown to this version", "remove it"
    if kind in KINDS_OF_VALUE:
        wanted = KINDS_OF_VALUE[kind]
        return f"is not {wanted} (found {quoted(found)})", f"give {wanted}"
    for name, relation in (("gt", "a number above"), ("ge", "a number from"),
                           ("le", "a number up to")):
        if name in context:
            limit = f"{relation} {context[name]:g}"
            return f"is out of range (found {quoted(found)})", f"give {limit}"
    if kind == "too_short":
        return (f"has {context['actual_length']} entries",
                f"give at least {context['min_length']}")
    if kind == "too_long":
        return f"has more than {context['max_length']} entries", "give no more"
    if kind == "literal_error":
        return f"is not {context['expected']} (found {quoted(found)})", "give what is expected"
    return f"is not as it should be (found {quoted(found)})", renew


def path_of(location: tuple[str | int, ...], where: str = "") -> str:
    """Return a path such as ``hysteresis.density_um_per_v2[3][2]`` for a location of pydantic."""
    path = where
    for name in location:
        if isinstance(name, int):
            path += f"[{name}]"
        elif not name.startswith(HIDDEN):
            shown = printable(name)
            path += f".{shown}" if path and not path.endswith(" ") else shown
    return path


def printable(name: str) -> str:
    """Return a name from a file in a form that fits on one line."""
    return name if name.isprintable() else repr(name)[1:-1]


def quoted(found: object) -> str:
    """Return a value from a file as text, shortened to fit into a sentence."""
    try:
        text = json.dumps(found, ensure_ascii=False, default=repr)
    except (ValueError, TypeError, RecursionError):
        text = type(found).__name__
    text = " ".join(text.split())
    return text if len(text) <= LONGEST_FOUND else text[:LONGEST_FOUND] + " ..."
