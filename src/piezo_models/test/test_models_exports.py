# SPDX-License-Identifier: BSD-3-Clause
import importlib
import subprocess
import sys

import pytest


def test_name_that_is_not_exported_is_refused_as_python_does():
    with pytest.raises(ImportError, match="cannot import name 'Preisach'"):
        from piezo_models import Preisach  # noqa: F401
    with pytest.raises(AttributeError, match="has no attribute 'Preisach'"):
        importlib.import_module("piezo_models").Preisach  # noqa: B018


def test_importing_the_package_loads_no_library():
    script = ("import sys, piezo_models; from piezo_models import e_y_percent; "
              "print(*{'numba', 'scipy', 'control', 'pydantic'} & sys.modules.keys())")
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True,
                          check=True)
    assert done.stdout.split() == []
