"""A transport that cannot be had is one sentence that says what to do."""

import sys

import pytest

from hardware.dvrk.choose_transport import make_transport
from hardware.dvrk.transport import TransportError


@pytest.mark.parametrize(
    ("kind", "package", "advice"), [("ros1", "rospy", "run `make ros`"), ("ros2", "rclpy", r"source the setup\.bash")]
)
def test_a_missing_ros_says_how_to_install_it(monkeypatch: pytest.MonkeyPatch, kind: str, package: str, advice: str) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    monkeypatch.delitem(sys.modules, f"hardware.dvrk.{kind}", raising=False)

    with pytest.raises(TransportError, match=advice) as error:
        make_transport(kind, "driver")

    assert package in str(error.value) or "rosgraph" in str(error.value)
    assert "\n" not in str(error.value)


def test_an_unknown_kind_names_those_there_are() -> None:
    with pytest.raises(TransportError, match="there is no transport 'ros3'; choose one of ros1, ros2"):
        make_transport("ros3", "driver")
