"""A real ROS 1 master, for the tests that need a graph of several processes."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.mocks.ros_master import RosMaster, ros_is_missing, running_master


def skip_without_ros() -> None:
    """Skip the test where ROS 1 is not installed."""
    if reason := ros_is_missing():
        pytest.skip(reason)


@pytest.fixture
def ros_master(tmp_path: Path) -> Iterator[RosMaster]:
    """A master for this test alone, with which its processes end; skips where ROS 1 is not installed."""
    skip_without_ros()
    with running_master(tmp_path) as master:
        yield master
