"""What each disturbance does to a frame, and that the truth sees none of it."""

import numpy as np
import pytest

from hardware.interface import CUTTER, Frame, StereoFrame
from hardware.stub.bench import StubBench
from hardware.stub.scene import load_scene
from supervisor.experiments.disturbances import (
    Blob,
    Dimmer,
    DisturbedBench,
    DisturbedEndoscope,
    Highlights,
    MotionBlur,
    RolledScene,
)


@pytest.fixture
def image():
    return np.random.default_rng(3).integers(40, 160, (120, 160, 3), dtype=np.uint8)


def blob(**more):
    usual = {"centre": (80.0, 60.0), "swing": (0.0, 0.0), "period": 3.0, "phase": 0.0, "radius": (6.0, 6.0), "shift": 30.0}
    return Blob(**{**usual, **more})


def middle_of(picture):
    """Centre (u, v) of what is saturated."""
    v, u = np.nonzero((picture == 255).all(axis=2))
    return u.mean(), v.mean()


def test_a_highlight_saturates_its_place_and_leaves_the_rest(image):
    picture = Highlights((blob(),), gloss=0.0).painted(image, 0, 0, 0)

    assert (picture[57:64, 77:84] == 255).all()
    assert (picture[:, :40] == image[:, :40]).all()


def test_a_highlight_moves_with_time_and_lies_elsewhere_in_the_right_eye(image):
    lights = Highlights((blob(swing=(20.0, 0.0), period=2.0),), gloss=0.0)

    now, later, right = (middle_of(lights.painted(image, eye, frame, 0)) for eye, frame in ((0, 0), (0, 15), (1, 0)))

    assert later[0] - now[0] == pytest.approx(20.0, abs=1.0)  # a quarter of the period later
    assert now[0] - right[0] == pytest.approx(30.0, abs=1.0)


def test_gloss_makes_only_what_is_bright_shine_more(image):
    image[10:20, 10:20] = 200

    picture = Highlights((), gloss=1.0).painted(image, 0, 0, 0)

    assert (picture[10:20, 10:20] == 230).all()
    assert (picture[30:] == image[30:]).all()


def test_the_light_is_dimmed_by_its_share_from_its_step_on(image):
    dimmer = Dimmer(from_step=4, lost=0.3)

    assert (dimmer.painted(image, 0, 0, 3) == image).all()
    assert dimmer.painted(image, 0, 0, 4).mean() == pytest.approx(0.7 * image.mean(), rel=0.01)


def test_motion_blur_takes_its_share_of_the_frames_and_the_same_ones_for_both_eyes(image):
    blur = MotionBlur(seed=5, share=0.4, length=(3.0, 7.0))

    left, right = ([bool((blur.painted(image, eye, k, 0) != image).any()) for k in range(200)] for eye in (0, 1))

    assert left == right
    assert 0.3 < np.mean(left) < 0.5


def test_motion_blur_smears_along_one_line_and_keeps_the_light(image):
    dot = np.zeros_like(image)
    dot[60, 80] = 240
    blur = MotionBlur(seed=5, share=1.0, length=(7.0, 7.0))

    picture = blur.painted(dot, 0, 2, 0).astype(float)[:, :, 0]

    v, u = np.nonzero(picture)
    spread = np.linalg.eigvalsh(np.cov(np.column_stack([u, v]).T, aweights=picture[v, u]))
    assert picture.sum() == pytest.approx(240, rel=0.05)
    assert spread[1] == pytest.approx(7.0**2 / 12, rel=0.3)
    assert spread[0] < 0.15 * spread[1]


class Still:
    """An endoscope whose picture stays the same while its sequence is what it is told."""

    camera = None

    def __init__(self, image):
        self.image, self.sequence = image, 0

    def stamp(self):
        return self.sequence / 30

    def left(self):
        return Frame(self.sequence, self.stamp(), self.image)

    def stereo(self):
        return StereoFrame(self.left(), self.image)


def test_a_frame_that_was_seen_once_does_not_change_while_the_pull_goes_on(image):
    still = Still(image)
    endoscope = DisturbedEndoscope(still, Dimmer(from_step=1))

    first = endoscope.left().image
    endoscope.step = 1
    again, right = endoscope.left().image, endoscope.stereo().right
    still.sequence = 1
    later = endoscope.left().image

    assert again is first
    assert (first == image).all()
    assert later.mean() < 0.75 * image.mean()
    assert right.mean() < 0.75 * image.mean()  # not seen before the light changed


def test_an_undisturbed_bench_shows_what_the_bench_beneath_shows(image):
    endoscope = DisturbedEndoscope(Still(image), None)

    assert endoscope.left().image is image


@pytest.fixture(scope="module")
def silicone():
    return load_scene("silicone")


def rolled(scene, degrees):
    return RolledScene(**vars(scene), roll=np.radians(degrees))


def test_a_rolled_camera_turns_the_picture_about_its_middle_and_keeps_distances(silicone):
    straight, turned = StubBench(silicone, 100), StubBench(rolled(silicone, 30.0), 100)

    line, other = (bench.drawn_goal()[0] - (319.5, 239.5) for bench in (straight, turned))

    angle = np.radians(30.0)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    assert other == pytest.approx(line @ turn.T, abs=0.1)
    assert turned.to_table(turned.to_camera(np.eye(3))) == pytest.approx(np.eye(3))


def test_the_rolled_eyes_see_the_same_tissue_one_baseline_apart(silicone):
    bench = StubBench(rolled(silicone, -40.0), 100)

    pair, depth = bench.endoscope.stereo(), bench.endoscope.rendering().depth
    disparity = bench.endoscope.camera.focal * bench.endoscope.camera.baseline / depth[220:260, 300:340].mean()
    patch = pair.left.image[200:280, 280:360].astype(float).ravel()
    alike = {
        shift: np.corrcoef(patch, pair.right[200:280, 280 - shift : 360 - shift].astype(float).ravel())[0, 1]
        for shift in range(20, 50)
    }

    assert max(alike, key=alike.get) == pytest.approx(disparity, abs=1.5)


def test_the_truth_below_a_disturbed_bench_sees_no_disturbance(silicone):
    bench = StubBench(silicone, 100)
    disturbed = DisturbedBench(bench, Highlights((blob(centre=(320.0, 240.0)),), gloss=1.0))
    before = bench.endoscope.rendering().image.copy()

    seen = disturbed.endoscope.left().image

    assert (seen != before).any()
    assert (bench.endoscope.rendering().image == before).all()
    assert disturbed.arms[CUTTER] is bench.arms[CUTTER]
