# SPDX-License-Identifier: BSD-3-Clause
import subprocess
import sys


def test_names_that_users_need_come_from_the_package():
    from piezo_identification import diagnose, identify, predict

    assert all(map(callable, (diagnose, identify, predict)))


def test_importing_the_package_loads_no_library():
    script = ("import sys, piezo_identification, piezo_identification.prediction; "
              "print(*{'numba', 'scipy', 'control', 'numpy'} & sys.modules.keys())")
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True,
                          check=True)
    assert done.stdout.split() == []
