# SPDX-License-Identifier: BSD-3-Clause
from piezo_studies.published_reference.__main__ import Followed, table


def test_table_holds_each_run_with_its_errors():
    text = table([Followed(None, False, 3.25, 0.6461, 0.00091, 0.0),
                  Followed(5, True, 0.1, 0.077, 0.0222, 0.022)])
    assert "| known before the run | none | 3.250 % | 646 nm | 0.0009 % | 0.0 ms |" in text
    assert ("| published, 5 samples of preview | H-infinity, 1 kHz | 0.100 % | 77 nm | 0.0222 % | "
            "22.0 ms |") in text
