"""Our messages to those of ROS and back: on the classes of ROS 1 where it is installed, and on strict ones of the shape of ROS 2."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hardware.dvrk import messages as m
from hardware.dvrk.ros_messages import from_ros, receiver, to_ros
from tests.hardware.dvrk.conftest import skip_without_ros
from tests.mocks import ros2_graph
from tests.mocks.ros1_nodes import EXAMPLES, same

RED, GREEN, BLUE = (200, 10, 20), (10, 200, 30), (20, 30, 200)


def of_ros2(ros: str) -> Any:
    return ros2_graph.strict(ros2_graph.MESSAGES[ros])()


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda example: type(example).__name__)
def test_what_goes_over_the_wire_of_ros_1_comes_back_the_same(example: m.Message) -> None:
    skip_without_ros()
    from io import BytesIO

    from hardware.dvrk.ros1_classes import message_class

    found, wire = message_class(example.ROS), BytesIO()
    to_ros(example, found()).serialize(wire)

    back = from_ros(type(example), found().deserialize(wire.getvalue()))

    assert same(back, example)


@given(stamp=st.floats(0.0, 4e9))
def test_a_stamp_keeps_its_value_to_a_microsecond(stamp: float) -> None:
    ros = to_ros(m.StringStamped(stamp, "home"), of_ros2("crtk_msgs/StringStamped"))

    assert 0 <= ros.header.stamp.nanosec < 10**9
    assert from_ros(m.StringStamped, ros).stamp == pytest.approx(stamp, abs=1e-6, rel=0.0)


def test_the_stamp_zero_that_means_invalid_stays_exactly_zero() -> None:
    ros = to_ros(m.OperatingState(0.0, "ENABLED", True, False), of_ros2("crtk_msgs/OperatingState"))

    assert from_ros(m.OperatingState, ros).stamp == 0.0


@pytest.mark.parametrize("stamp", [-1.0, float("nan"), float("inf")])
def test_a_stamp_that_is_no_time_is_refused(stamp: float) -> None:
    with pytest.raises(ValueError, match="the stamp of a message"):
        to_ros(m.StringStamped(stamp, "home"), of_ros2("crtk_msgs/StringStamped"))


def test_a_pose_that_is_not_a_number_goes_through_for_the_driver_to_refuse() -> None:
    pose = m.PoseStamped(1.0, "base", np.array((np.nan, 0.0, 0.0)), np.array((0.0, 0.0, 0.0, 3.0)))

    back = from_ros(m.PoseStamped, to_ros(pose, of_ros2("geometry_msgs/PoseStamped")))

    assert np.isnan(back.position[0])
    assert back.quaternion.tolist() == [0.0, 0.0, 0.0, 3.0]


def test_a_position_of_two_numbers_is_refused() -> None:
    pose = m.PoseStamped(1.0, "base", np.zeros(2), np.array((0.0, 0.0, 0.0, 1.0)))

    with pytest.raises(ValueError, match="position has 2 numbers, and must have 3"):
        to_ros(pose, of_ros2("geometry_msgs/PoseStamped"))


@pytest.mark.parametrize(
    ("encoding", "pixel"),
    [("rgb8", RED), ("bgr8", RED[::-1]), ("rgba8", (*RED, 7)), ("bgra8", (*RED[::-1], 7)), ("8UC3", RED[::-1])],
)
def test_a_picture_of_any_colour_order_is_read_as_red_green_blue(encoding: str, pixel: tuple[int, ...]) -> None:
    picture = raw_picture(encoding, np.full((2, 3, len(pixel)), pixel, np.uint8), padding=0)

    assert (from_ros(m.Picture, picture).image == RED).all()


def test_a_grey_picture_is_read_as_three_equal_channels() -> None:
    picture = raw_picture("mono8", np.full((2, 3, 1), 90, np.uint8), padding=0)

    assert from_ros(m.Picture, picture).image.shape == (2, 3, 3)
    assert (from_ros(m.Picture, picture).image == 90).all()


def test_padding_at_the_end_of_rows_is_left_out() -> None:
    pixels = np.array([[RED, GREEN], [BLUE, RED]], np.uint8)

    assert np.array_equal(from_ros(m.Picture, raw_picture("rgb8", pixels, padding=5)).image, pixels)


def test_a_picture_with_too_few_bytes_is_refused() -> None:
    picture = raw_picture("rgb8", np.zeros((2, 3, 3), np.uint8), padding=0)
    picture.height = 3

    with pytest.raises(ValueError, match="too few"):
        from_ros(m.Picture, picture)


def test_an_unknown_encoding_names_those_that_are_read() -> None:
    with pytest.raises(ValueError, match="'bayer_rggb8'; publish one of rgb8"):
        from_ros(m.Picture, raw_picture("bayer_rggb8", np.zeros((2, 2, 1), np.uint8), padding=0))


def raw_picture(encoding: str, pixels: Any, padding: int) -> Any:
    ros = of_ros2("sensor_msgs/Image")
    ros.height, ros.width = pixels.shape[:2]
    ros.encoding, ros.step = encoding, pixels.shape[1] * pixels.shape[2] + padding
    rows = pixels.reshape(pixels.shape[0], -1)
    ros.data.frombytes(np.pad(rows, ((0, 0), (0, padding))).tobytes())
    return ros


@pytest.mark.parametrize(
    ("strides", "numbers"),
    [((1, 2), [1.0, 4.0, 2.0, 5.0, 3.0, 6.0]), ((6, 3), [1.0, 2.0, 3.0, 4.0, 5.0, 6.0])],
    ids=["dVRK", "ROS"],
)
def test_a_matrix_is_read_by_the_strides_that_come_with_it(strides: tuple[int, int], numbers: list[float]) -> None:
    ros = of_ros2("std_msgs/Float64MultiArray")
    ros.layout.dim = [of_ros2("std_msgs/MultiArrayDimension") for _ in range(2)]
    for side, size, stride in zip(ros.layout.dim, (2, 3), strides, strict=True):
        side.size, side.stride = size, stride
    ros.data = numbers

    assert from_ros(m.Matrix, ros).data.tolist() == [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]


def test_a_matrix_whose_sides_do_not_fit_is_refused() -> None:
    ros = of_ros2("std_msgs/Float64MultiArray")
    ros.layout.dim = [of_ros2("std_msgs/MultiArrayDimension")]
    ros.data = [1.0]

    with pytest.raises(ValueError, match="two sides are expected"):
        from_ros(m.Matrix, ros)


def test_what_cannot_be_understood_is_dropped_and_said_once(caplog: pytest.LogCaptureFixture) -> None:
    came: list[tuple[m.Picture, float]] = []
    receive = receiver("/stereo/left/image_raw", m.Picture, lambda message, at: came.append((message, at)), lambda: 7.0)
    good = to_ros(m.Picture(1.0, "left", np.zeros((2, 2, 3), np.uint8)), of_ros2("sensor_msgs/Image"))
    bad = to_ros(m.Picture(1.0, "left", np.zeros((2, 2, 3), np.uint8)), of_ros2("sensor_msgs/Image"))
    bad.encoding = "yuv422"

    for ros in (bad, good, bad):
        receive(ros)

    assert [at for _, at in came] == [7.0]
    assert [record.getMessage().startswith("what comes over /stereo/left/image_raw is dropped") for record in caplog.records] == [
        True
    ]


def test_a_picture_is_a_copy_that_may_be_drawn_on() -> None:
    ros = to_ros(m.Picture(1.0, "left", np.zeros((2, 2, 3), np.uint8)), of_ros2("sensor_msgs/Image"))

    image = from_ros(m.Picture, ros).image
    image[0, 0] = 255

    assert from_ros(m.Picture, ros).image.max() == 0
