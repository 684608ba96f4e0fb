# SPDX-License-Identifier: BSD-3-Clause
"""Replace parts of the product for a while."""

from contextlib import contextmanager

import pytest


@contextmanager
def replaced(*changes):
    """Replace attributes, each given as (owner, name, replacement), until the context ends."""
    with pytest.MonkeyPatch.context() as patch:
        for change in changes:
            patch.setattr(*change)
        yield
