"""The stereo camera on the graph (reference 8): pairs at their rate, with a calibration that says what they are."""

import time

import numpy as np

from hardware.dvrk import messages as m
from hardware.dvrk.endoscope import camera_model
from hardware.served.node import Serving

RAW = {eye: f"/stereo/{eye}/image_raw" for eye in ("left", "right")}
INFO = {eye: f"/stereo/{eye}/camera_info" for eye in ("left", "right")}


def look(rig):
    for topic in RAW.values():
        rig.listen(topic, m.Picture)
    for topic in INFO.values():
        rig.listen(topic, m.CameraInfo)
    return rig


def test_pictures_come_at_their_rate_in_pairs(make_rig):
    rig = look(make_rig(serving=Serving(pictures=10.0)))
    rig.go(1.0)

    left, right = (rig.heard[RAW[eye]] for eye in ("left", "right"))
    assert len(left) == len(right) == 10
    assert [a[1].stamp for a in left] == [b[1].stamp for b in right]


def test_a_picture_is_what_the_stub_shows(make_rig):
    rig = look(make_rig(serving=Serving(pictures=5.0)))
    rig.go(0.25)

    shown = rig.bench.endoscope.stereo()
    picture = rig.newest(RAW["left"])
    assert picture.image.shape == (480, 640, 3) and picture.image.dtype == np.uint8
    assert np.abs(picture.image.astype(float) - shown.left.image).mean() < 5.0


def test_the_calibration_is_that_of_the_stubs_camera(make_rig):
    rig = look(make_rig(serving=Serving(pictures=5.0)))
    rig.go(0.25)

    assert camera_model(rig.newest(INFO["left"]), rig.newest(INFO["right"])) == rig.bench.endoscope.camera


def test_the_topics_of_rectified_pictures_are_there_too(make_rig):
    rig = make_rig(serving=Serving(pictures=5.0))
    rig.listen("/stereo/left/image_rect_color", m.Picture)
    rig.go(0.25)

    assert len(rig.heard["/stereo/left/image_rect_color"]) >= 1


def test_nothing_is_rendered_while_nobody_looks(make_rig):
    rig = make_rig()
    rig.bench.endoscope.stereo = None  # would fail if called

    rig.go(0.2)


def test_a_thread_of_its_own_renders_without_holding_up_the_bench(make_rig):
    rig = look(make_rig(serving=Serving(pictures=30.0, threaded=True)))
    for _ in range(30):
        rig.go(0.05)
        time.sleep(0.01)
    rig.served.close()

    stamps = [message.stamp for _, message in rig.heard[RAW["left"]]]
    assert 2 <= len(stamps) <= 45
    assert stamps == sorted(stamps)
