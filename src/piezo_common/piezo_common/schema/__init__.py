# SPDX-License-Identifier: BSD-3-Clause
"""Common schema layer for all files of the suite: types, units, ranges, versions, messages."""

from piezo_common.schema.checking import SchemaError, check
from piezo_common.schema.fields import (
    Document,
    NotNegative,
    Number,
    NumberOrNumbers,
    Numbers,
    NumberTree,
    Part,
    Positive,
    entry,
    require_matrices,
    violation,
)
from piezo_common.schema.reading import checked, load_document, parsed

__all__ = [
    "Document", "NotNegative", "Number", "NumberOrNumbers", "NumberTree", "Numbers", "Part",
    "Positive", "SchemaError", "check", "checked", "entry", "load_document", "parsed",
    "require_matrices", "violation",
]
