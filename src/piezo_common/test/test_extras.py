# SPDX-License-Identifier: BSD-3-Clause
"""What is said where a library of an extra is missing."""

import sys

from piezo_common.extras import how_to_install


def test_environment_of_the_setup_gets_its_extras_by_make(tmp_path, monkeypatch):
    (tmp_path / "stamp").touch()
    monkeypatch.setattr(sys, "prefix", str(tmp_path))
    assert how_to_install("pandas", "frames") == "install it (`make extras`)"


def test_any_other_environment_gets_the_package_or_the_extra_by_pip(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "prefix", str(tmp_path))
    said = how_to_install("pandas", "frames")
    assert "`pip install pandas`" in said and "'.[frames]'" in said
