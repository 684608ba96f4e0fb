# SPDX-License-Identifier: BSD-3-Clause
"""Start the process of a node so that Ctrl-C is quiet from its first moment on."""

import importlib
import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from types import FrameType

INTERRUPTED_STATUS = 130


def node_entry(module: str) -> Callable[[list[str] | None], None]:
    """Return what the executable of a node calls.

    Importing a node takes seconds, in which nothing runs yet that had to be ended in order. A
    signal then ends the process at once with one line. The node, once it is made, ends in order.

    Parameters
    ----------
    module : str
        Full name of the node's module, whose function ``main`` runs the node.

    Returns
    -------
    callable
    """
    def main(args: list[str] | None = None) -> None:
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, _leave)
        return importlib.import_module(module).main(args)

    main.__module__ = module
    return main


def _leave(number: int, frame: FrameType | None) -> None:
    # Neither an exception, which an import may swallow or tell as its own, nor what Python does
    # at its end: what is half imported may fail there.
    name = Path(sys.argv[0]).name
    os.write(sys.stderr.fileno(), f"{name}: interrupted while it started\n".encode())
    os._exit(INTERRUPTED_STATUS)
