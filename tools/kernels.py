# SPDX-License-Identifier: BSD-3-Clause
"""Run a command once under each of the OpenBLAS kernels that this processor can take.

    python tools/kernels.py [--others] COMMAND...

OpenBLAS chooses its kernels by the processor, so the last digits of a result depend on the machine.
OPENBLAS_CORETYPE makes it choose those of another processor. A kernel is taken if a calculation
under it ends and NumPy and SciPy both say that they use it; where fewer than KERNELS_WANTED are
there, as on processors that are not x86 and with another BLAS, that is said and the others are run.
"""

import argparse
import os
import subprocess
import sys

VARIABLE = "OPENBLAS_CORETYPE"
KERNELS_WANTED = 3
# AMD's Zen takes Haswell's. The last one is of any 64-bit x86 processor.
CANDIDATES = ("Haswell", "SkylakeX", "Sandybridge", "Nehalem")
# Prints the kernels that the libraries say they use, after a calculation that would crash if the
# processor lacked an instruction.
PROBE = """
import ctypes, re
import numpy as np
import scipy.linalg

matrix = np.random.default_rng(0).normal(size=(64, 64))
np.linalg.eig(matrix @ matrix.T)
scipy.linalg.schur(matrix)
with open("/proc/self/maps") as maps:
    # The path is the rest of a line, and may hold spaces.
    libraries = sorted(set(re.findall(r"/.*openblas.*", maps.read())))
for path in libraries:
    library = ctypes.CDLL(path)
    for name in ("scipy_openblas_get_corename64_", "scipy_openblas_get_corename",
                 "openblas_get_corename64_", "openblas_get_corename"):
        if hasattr(library, name):
            function = getattr(library, name)
            function.restype = ctypes.c_char_p
            print(function().decode())
            break
"""


def environment(kernel: str) -> dict[str, str]:
    """Return the variables of a process in which OpenBLAS takes a kernel."""
    return os.environ | {VARIABLE: kernel}


def kernels_in_use(requested: str | None = None) -> set[str]:
    """Return the names of the kernels that NumPy and SciPy use, as it is or if one is requested."""
    probe = subprocess.run([sys.executable, "-c", PROBE],
                           env=environment(requested) if requested else None, capture_output=True,
                           text=True, check=False)
    return set(probe.stdout.split()) if probe.returncode == 0 else set()


def kernels_that_work() -> tuple[set[str], list[str]]:
    """Return the kernel in use here, a set, and others that take effect: KERNELS_WANTED in all."""
    own = kernels_in_use()
    others = [kernel for kernel in CANDIDATES
              if kernel not in own and kernels_in_use(kernel) == {kernel}]
    return own, others[:KERNELS_WANTED - 1]


def main(arguments: list[str] | None = None) -> int:
    """Run the command; return the first exit status that is not 0."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--others", action="store_true",
                        help="not under the kernel that is in use without it")
    parser.add_argument("command", nargs=argparse.REMAINDER)
    options = parser.parse_args(arguments)
    own, kernels = kernels_that_work()
    if len(own) != 1 or len(kernels) + 1 < KERNELS_WANTED:
        print(f"kernels: {', '.join(sorted(own)) or 'no OpenBLAS'} in use, and of "
              f"{', '.join(CANDIDATES)} only {', '.join(kernels) or 'none'} can be chosen by "
              f"{VARIABLE} on this processor; the rest is skipped", flush=True)
    if not options.others:
        kernels = [*own, *kernels]
    status = 0
    for kernel in kernels:
        print(f"kernels: under {kernel}: {' '.join(options.command)}", flush=True)
        ended = subprocess.run(options.command, env=environment(kernel), check=False)
        status = status or ended.returncode
    return status


if __name__ == "__main__":
    sys.exit(main())
