# SPDX-License-Identifier: BSD-3-Clause
"""The page of the files tells the fields that the schemas check."""

import file_tables


def test_tables_are_up_to_date():
    assert file_tables.main(["--check"]) == 0, "run make tables"


def test_table_tells_type_unit_range_and_meaning():
    assert ("| `lead_ticks` | whole number |  | >= 1, <= 1e+09 | How many ticks ahead the output "
            "is written. |\n") in file_tables.table_of("calibration")
    assert ("| `hysteresis.density_um_per_v2` | list of lists of numbers | um/V^2 | >= 0, 1 or "
            "more entries |") in file_tables.table_of("model")
