"""Definitions of crtk_msgs are those of the dVRK: the md5 sums say so."""

import pytest

from hardware.dvrk.crtk_definitions import MD5, MESSAGES, SERVICES
from hardware.dvrk.transport import TransportError
from tests.hardware.dvrk.conftest import skip_without_ros


@pytest.mark.parametrize("ros", MD5)
def test_the_md5_sum_is_the_robots(ros: str) -> None:
    skip_without_ros()
    from hardware.dvrk.ros1_classes import message_class, service_class

    found = service_class(ros) if ros in SERVICES else message_class(ros)

    assert found._md5sum == MD5[ros]
    assert found._type == ros


def test_every_definition_has_a_known_sum() -> None:
    assert {*MESSAGES, *SERVICES} <= set(MD5)


def test_a_definition_with_fields_in_another_order_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    skip_without_ros()
    from hardware.dvrk import ros1_classes

    changed = {**MESSAGES, "crtk_msgs/OperatingState": "std_msgs/Header header\nbool is_homed\nstring state\nbool is_busy\n"}
    monkeypatch.setattr(ros1_classes, "MESSAGES", changed)

    with pytest.raises(TransportError, match="defines crtk_msgs/OperatingState otherwise"):
        ros1_classes.message_class.__wrapped__("crtk_msgs/OperatingState")


def test_a_missing_package_is_one_sentence() -> None:
    skip_without_ros()
    from hardware.dvrk.ros1_classes import message_class

    with pytest.raises(TransportError, match="apt-get install python3-stereo-msgs"):
        message_class("stereo_msgs/DisparityImage")
