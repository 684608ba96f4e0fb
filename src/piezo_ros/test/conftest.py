# SPDX-License-Identifier: BSD-3-Clause
"""Nodes of these tests meet no others of this machine."""

import pytest


@pytest.fixture(scope="session", autouse=True)
def domain(domain_of_our_own):
    """A ROS domain of our own."""
    return domain_of_our_own
