"""Pairs of images with bounded skew, rectified, and cameras that were never calibrated."""

from dataclasses import replace

import numpy as np
import pytest

from hardware.codes import InputError
from hardware.dvrk.config import CameraConfig
from hardware.dvrk.endoscope import EndoscopeDVRK, camera_model
from hardware.dvrk.local import LocalGraph
from hardware.dvrk.messages import CameraInfo, Picture
from tests.mocks.robot import K, camera_info

SIZE = (64, 48)


class Table:
    """A camera on a graph and the endoscope that looks through it."""

    def __init__(self, rectified: bool = True, ahead: float = 0.0) -> None:
        self.time = 10.0
        graph = LocalGraph(lambda: self.time)
        self.node = graph.node("camera", ahead)
        name = "image_rect_color" if rectified else "image_raw"
        self.pictures = {eye: self.node.publisher(f"/stereo/{eye}/{name}", Picture) for eye in ("left", "right")}
        self.infos = {eye: self.node.publisher(f"/stereo/{eye}/camera_info", CameraInfo) for eye in ("left", "right")}
        self.endoscope = EndoscopeDVRK(graph.node("driver"), CameraConfig(rectified=rectified), "", 10.0)

    def calibrate(self, k: np.ndarray = K, **changes: object) -> None:
        for eye, publisher in self.infos.items():
            publisher.publish(replace(camera_info(eye, self.node.stamp(), k), **changes))

    def send(self, eye: str, value: int, late: float = 0.0, stamp: float | None = None) -> None:
        when = self.node.stamp() - late if stamp is None else stamp
        self.pictures[eye].publish(Picture(when, eye, np.full((48, 64, 3), value, dtype=np.uint8)))

    def both(self, value: int, skew: float = 0.0) -> None:
        self.time += 1 / 30
        self.send("left", value)
        self.send("right", value + 100, late=skew)


def test_two_images_of_one_instant_are_a_pair():
    table = Table()
    table.calibrate()

    table.both(1)
    frame = table.endoscope.stereo()

    assert frame.left.image[0, 0, 0] == 1 and frame.right[0, 0, 0] == 101
    assert frame.left.stamp == table.endoscope.stamp() == pytest.approx(table.time - 10.0, abs=1e-5)


def test_each_pair_is_a_new_frame_and_one_pair_stays_one_frame():
    table = Table()
    table.calibrate()
    table.both(1)
    first, again = table.endoscope.left(), table.endoscope.left()

    table.both(2)

    assert (first.sequence, again.sequence, table.endoscope.left().sequence) == (0, 0, 1)
    assert again.image is first.image


def test_a_small_skew_is_taken_and_the_older_eye_tells_the_age():
    table = Table()
    table.calibrate()

    for k in range(5):
        table.both(k, skew=0.015)

    assert table.endoscope.left().image[0, 0, 0] == 4


@pytest.mark.parametrize("skew", [0.021, 0.4])
def test_eyes_that_are_too_far_apart_make_no_pair(skew: float):
    table = Table()
    table.calibrate()

    table.both(1, skew=skew)

    assert table.endoscope.stamp() == -np.inf


def test_an_eye_that_lags_is_paired_with_the_image_that_it_belongs_to():
    table = Table()
    table.calibrate()

    for k in range(5):
        table.both(k, skew=1 / 30 + 0.002)  # one picture and a bit behind

    frame = table.endoscope.stereo()
    assert (frame.left.image[0, 0, 0], frame.right[0, 0, 0]) == (3, 104)


def test_one_eye_alone_makes_no_pair_and_the_newest_pair_grows_old():
    table = Table()
    table.calibrate()
    table.both(1)
    old = table.endoscope.stamp()

    for k in range(10):
        table.time += 1 / 30
        table.send("left", k)

    assert table.endoscope.stamp() == old
    assert table.endoscope.unpaired > 0


def test_no_pair_at_all_is_no_frame():
    with pytest.raises(RuntimeError, match="no pair"):
        Table().endoscope.left()


def test_an_image_without_a_stamp_is_not_used():
    table = Table()
    table.calibrate()

    table.send("left", 1, stamp=0.0)
    table.send("right", 1, stamp=0.0)

    assert table.endoscope.stamp() == -np.inf


@pytest.mark.parametrize("ahead", [-5.0, 5.0])
def test_a_camera_whose_clock_is_off_is_as_fresh_as_it_is(ahead: float):
    table = Table(ahead=ahead)
    table.calibrate()

    table.both(1)

    assert table.endoscope.stamp() == pytest.approx(table.time - 10.0, abs=1e-5)


def test_the_camera_model_is_the_rectified_one():
    table = Table()
    table.calibrate()

    camera = table.endoscope.camera

    assert (camera.width, camera.height, camera.focal, camera.cu, camera.cv) == (64, 48, 600.0, 319.5, 239.5)
    assert camera.baseline == pytest.approx(0.004)


def test_a_camera_that_tells_no_calibration_is_refused():
    with pytest.raises(InputError, match="camera_info"):
        _ = Table().endoscope.camera


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"K": np.zeros((3, 3)), "P": np.zeros((3, 4))}, "not calibrated"),
        ({"P": np.hstack([np.diag([600.0, 500.0, 1.0]), np.zeros((3, 1))])}, "square"),
    ],
)
def test_a_calibration_that_cannot_be_used_is_refused(change: dict, said: str):
    table = Table()
    table.calibrate(**change)

    with pytest.raises(InputError, match=said):
        _ = table.endoscope.camera


def test_two_cameras_that_are_no_pair_are_refused():
    left, right = camera_info("left", 1.0, K), camera_info("right", 1.0, K)
    other = right.P.copy()
    other[1, 2] += 4.0

    with pytest.raises(InputError, match="one stereo pair"):
        camera_model(left, replace(right, P=other))
    with pytest.raises(InputError, match="baseline"):
        camera_model(left, replace(right, P=left.P))


def test_raw_images_are_rectified_here():
    table = Table(rectified=False)
    k = np.array([[60.0, 0, 31.5], [0, 60.0, 23.5], [0, 0, 1]])
    for eye, publisher in table.infos.items():
        info = camera_info(eye, table.node.stamp(), k)
        p = info.P.copy()
        p[0, 2] += 4.0  # rectified, everything lies 4 pixels further right
        publisher.publish(replace(info, P=p))
    table.time += 1 / 30
    ramp = np.repeat(np.arange(64, dtype=np.uint8)[None, :, None], 48, axis=0).repeat(3, axis=2)
    for eye, publisher in table.pictures.items():
        publisher.publish(Picture(table.node.stamp(), eye, ramp))

    frame = table.endoscope.stereo()

    assert np.array_equal(frame.left.image[:, 10:60, 0], ramp[:, 6:56, 0])
    assert np.array_equal(frame.right[:, 10:60, 0], ramp[:, 6:56, 0])


@pytest.mark.parametrize("rectified", [True, False])
def test_images_of_another_size_than_their_calibration_make_no_pair_and_say_why(rectified: bool):
    table = Table(rectified)
    table.calibrate(width=128)

    table.both(1)

    assert table.endoscope.stamp() == -np.inf
    assert table.endoscope.unfit() == [
        f"the {eye} image is 64 x 48 pixels where its calibration says 128 x 48" for eye in ("left", "right")
    ]


def test_a_camera_that_changes_its_size_lets_the_newest_pair_grow_old_until_it_changes_back():
    table = Table()
    table.calibrate()
    table.both(1)
    old = table.endoscope.stamp()

    table.time += 1 / 30
    for eye, publisher in table.pictures.items():
        publisher.publish(Picture(table.node.stamp(), eye, np.zeros((96, 128, 3), dtype=np.uint8)))
    during = (table.endoscope.stamp(), table.endoscope.left().image[0, 0, 0], len(table.endoscope.unfit()))
    table.both(2)

    assert during == (old, 1, 2)
    assert table.endoscope.left().image[0, 0, 0] == 2 and table.endoscope.unfit() == []


def test_before_the_calibration_is_told_images_make_no_pair():
    table = Table()

    table.both(1)

    assert table.endoscope.stamp() == -np.inf


def test_a_calibration_that_is_told_again_is_the_same_and_one_that_is_gone_is_told():
    table = Table()
    table.calibrate()
    table.both(1)
    table.time += 0.1
    table.calibrate()
    assert table.endoscope.changed() == ""

    table.time += 0.1
    table.calibrate(np.zeros((3, 3)))

    assert table.endoscope.changed() == "the left camera's calibration is gone (its K is zero) since the session began"


@pytest.mark.parametrize("skew", [0.0, 0.05])
def test_by_how_much_the_eyes_stamps_differ_is_told_by_when_their_images_arrive(skew: float):
    table = Table(ahead=3.0)
    table.calibrate()
    assert table.endoscope.apart() == 0.0

    for k in range(12):
        table.both(k, skew)

    assert table.endoscope.apart() == pytest.approx(skew, abs=1e-6)
