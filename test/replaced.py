# SPDX-License-Identifier: BSD-3-Clause
"""Replace parts of the product for a while."""

from contextlib import contextmanager

import pytest


@contextmanager
def replaced(*changes):
    """Put something else where each change (owner, name, instead) tells, until the context ends."""
    with pytest.MonkeyPatch.context() as patch:
        for change in changes:
            patch.setattr(*change)
        yield
