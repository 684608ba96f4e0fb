# SPDX-License-Identifier: BSD-3-Clause
"""Run numerics under several kernels of OpenBLAS, as other processors would choose them.

Print the kernels that this processor runs, one a line: python tools/blas_kernels.py
Run a command under each of them:                      python tools/blas_kernels.py COMMAND ...
"""

import ctypes
import glob
import os
import platform
import subprocess
import sys
from pathlib import Path

import numpy as np

VARIABLE = "OPENBLAS_CORETYPE"
NEEDED_FLAGS = {"Nehalem": {"sse4_2"}, "Sandybridge": {"avx"}, "Haswell": {"avx2", "fma"},
                "SkylakeX": {"avx512f", "avx512bw", "avx512vl"}}
"""Kernels that round differently, with what a processor needs for each; AMD's take Haswell's."""


def loaded_kernel() -> str:
    """Name the kernel that NumPy's OpenBLAS has chosen; empty where it does not tell."""
    libraries = glob.glob(str(Path(np.__file__).parents[1] / "numpy.libs" / "*openblas*"))
    for library in map(ctypes.CDLL, libraries):
        for name in ("scipy_openblas_get_corename64_", "openblas_get_corename64_",
                     "openblas_get_corename"):
            if hasattr(library, name):
                tell = getattr(library, name)
                tell.restype = ctypes.c_char_p
                return tell().decode()
    return ""


def environment(kernel: str) -> dict[str, str]:
    """Give the variables of a process in which OpenBLAS takes a kernel, on one thread."""
    return {**os.environ, VARIABLE: kernel, "OPENBLAS_NUM_THREADS": "1"}


def usable_kernels() -> list[str]:
    """List the kernels that this processor runs and this OpenBLAS has.

    Returns
    -------
    list of str
        Empty where the processor is none of Intel's or AMD's, or OpenBLAS ignores the variable.
    """
    if platform.machine() not in ("x86_64", "AMD64"):
        return []
    flags = _processor_flags()
    return [kernel for kernel, needed in NEEDED_FLAGS.items()
            if needed <= flags and _takes(kernel)]


def _processor_flags():
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return set()
    return next((set(line.split(":")[1].split()) for line in lines if line.startswith("flags")),
                set())


def _takes(kernel):
    told = subprocess.run([sys.executable, "-c", f"""
import sys
sys.path.insert(0, {str(Path(__file__).parent)!r})
from blas_kernels import loaded_kernel
print(loaded_kernel())"""], env=environment(kernel), capture_output=True, text=True)
    return told.stdout.strip().lower() == kernel.lower()


def main(command):
    """Run the command under each kernel, or list the kernels; return the first bad status."""
    kernels = usable_kernels()
    if not command:
        print("\n".join(kernels))
        return 0
    if not kernels:
        print(f"no kernel of OpenBLAS can be chosen here by {VARIABLE}: nothing is run",
              file=sys.stderr)
    status = 0
    for kernel in kernels:
        print(f"{VARIABLE}={kernel}", flush=True)
        status = status or subprocess.run(command, env=environment(kernel)).returncode
    return status


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
