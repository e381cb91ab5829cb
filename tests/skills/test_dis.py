"""The DIS tracker on warped speckle: accuracy, what hides a point, and how it comes back."""

import cv2
import numpy as np
import pytest

from skills.tracking.anchor import AnchorConfig
from skills.tracking.dis import TrackerConfig, TrackerDIS
from skills.tracking.hidden import HiddenConfig
from tests.skills.pictures import SIZE, coloured, frame, opened, speckle

LINE = 120.0


def grid_points() -> np.ndarray:
    u, v = np.meshgrid(np.arange(90.0, 231.0, 20.0), [90.0, 104.0, 112.0, 128.0, 136.0, 150.0])
    return np.column_stack([u.ravel(), v.ravel()])


def sides(points: np.ndarray) -> np.ndarray:
    return (points[:, 1] > LINE).astype(np.int64)


def test_points_follow_a_stretch_and_an_opening_to_within_a_pixel() -> None:
    texture, points = speckle(1), grid_points()
    tracker = TrackerDIS()
    tracker.start(frame(coloured(texture, 2.0, 0), 0), points, sides(points))
    for k in range(1, 16):
        picture, went = opened(texture, 2.0 * k, LINE, 0.004 * k)
        tracks = tracker.update(frame(coloured(picture, 2.0, k), k))
    error = np.linalg.norm(tracks.points - went(points), axis=1)
    assert np.median(error) < 0.4
    assert np.percentile(error[tracks.visible], 90) < 1.5
    assert tracks.visible.mean() > 0.9
    assert tracks.stamp == pytest.approx(0.5)


def test_the_anchor_keeps_drift_far_below_that_of_chained_flow() -> None:
    texture, points = speckle(2), grid_points()
    errors = []
    for anchor in (AnchorConfig(), None):
        tracker = TrackerDIS(TrackerConfig(anchor=anchor))
        tracker.start(frame(coloured(texture, 3.0, 0), 0), points, sides(points))
        for k in range(1, 31):
            shift = np.array([[1, 0, 0.7 * k], [0, 1, 0.3 * k]], dtype=np.float32)
            picture = cv2.warpAffine(texture, shift, SIZE, borderMode=cv2.BORDER_REFLECT)
            tracks = tracker.update(frame(coloured(np.asarray(picture), 3.0, k), k))
        errors.append(np.median(np.linalg.norm(tracks.points - points - [21.0, 9.0], axis=1)))
    assert errors[0] < 0.25 * errors[1]


def test_a_dimmer_lamp_and_pale_texture_do_not_matter() -> None:
    texture, points = speckle(12, contrast=0.15), grid_points()
    tracker = TrackerDIS()
    tracker.start(frame(coloured(texture, 1.5, 0), 0), points, sides(points))
    for k in range(1, 11):
        picture, went = opened(texture, 1.5 * k, LINE)
        tracks = tracker.update(frame(coloured(picture * (1.0 - 0.05 * k), 1.5, k), k))
    error = np.linalg.norm(tracks.points - went(points), axis=1)
    assert np.median(error) < 0.5
    assert tracks.visible.mean() > 0.9


def test_a_reference_that_no_longer_holds_is_replaced() -> None:
    texture, other, points = speckle(13), speckle(14), grid_points()
    errors = []
    for least in (AnchorConfig().min_holding, 0.0):
        tracker = TrackerDIS(TrackerConfig(anchor=AnchorConfig(min_holding=least)))
        tracker.start(frame(coloured(texture, 1.0, 0), 0), points, sides(points))
        # The tissue changes its looks altogether while it moves.
        for k in range(1, 31):
            changed = min(1.0, k / 25)
            mixed = (1 - changed) * texture + changed * other
            shift = np.array([[1, 0, 0.5 * k], [0, 1, 0.0]], dtype=np.float32)
            picture = np.asarray(cv2.warpAffine(mixed, shift, SIZE, borderMode=cv2.BORDER_REFLECT))
            tracks = tracker.update(frame(coloured(picture, 1.0, k), k))
        errors.append(np.median(np.linalg.norm(tracks.points - points - [15.0, 0.0], axis=1)))
        if least > 0:
            assert tracks.visible.mean() > 0.95
            assert tracks.confidence.mean() > 0.9
    assert errors[0] < 0.6 * errors[1]


def test_a_side_that_a_tool_hides_altogether_keeps_its_reference() -> None:
    texture, points = speckle(15), grid_points()
    upper = points[:, 1] < LINE
    mask = np.zeros(SIZE[::-1], dtype=bool)
    mask[60 : int(LINE), :] = True
    tracker = TrackerDIS()
    tracker.start(frame(coloured(texture, 1.0, 0), 0), points, sides(points))
    for k in range(1, 7):
        image = coloured(np.roll(texture, k, axis=1), 1.0, k)
        # What covers the side has a texture too, and goes the other way.
        image[mask] = coloured(np.roll(speckle(16), -3 * k, axis=1), 1.0, k)[mask]
        hidden = tracker.update(frame(image, k), mask)
    assert not hidden.visible[upper].any()
    again = tracker.update(frame(coloured(np.roll(texture, 7, axis=1), 1.0, 7), 7), np.zeros_like(mask))
    assert again.visible[upper].mean() > 0.8
    assert np.linalg.norm(again.points - points - [7.0, 0.0], axis=1)[again.visible].max() < 2.0


def test_points_under_a_highlight_that_grows_are_not_seen_in_the_end() -> None:
    texture, points = speckle(17), grid_points()
    tracker = TrackerDIS()
    tracker.start(frame(coloured(texture, 1.0, 0), 0), points, sides(points))
    here = (points[:, 0] > 140) & (points[:, 0] < 180) & (points[:, 1] < LINE)
    for k in range(1, 21):
        picture = texture.copy()
        picture[80:118, 135:185] = (1 - k / 20) * texture[80:118, 135:185] + k / 20 * 230
        tracks = tracker.update(frame(coloured(picture, 1.0, k), k))
    assert tracks.visible[here].mean() < 0.5
    assert tracks.confidence[here].mean() < 0.2
    assert tracks.visible[~here].mean() > 0.9
    assert tracks.confidence[~here].mean() > 0.9


def test_a_point_under_a_tool_is_hidden_goes_with_its_side_and_is_found_again() -> None:
    texture, points = speckle(3), grid_points()
    mask = np.zeros(SIZE[::-1], dtype=bool)
    mask[80:125, 135:165] = True
    under = mask[points[:, 1].astype(int), points[:, 0].astype(int)]
    tracker = TrackerDIS()
    tracker.start(frame(coloured(texture, 1.0, 0), 0), points, sides(points))
    for k in range(1, 7):
        picture, went = opened(texture, 1.5 * k, LINE)
        image = coloured(picture, 1.0, k)
        image[mask] = (100, 102, 108)
        hidden = tracker.update(frame(image, k), mask)
    assert not hidden.visible[under].any()
    assert (hidden.confidence[under] == 0).all()
    assert np.linalg.norm(hidden.points - went(points), axis=1)[under].max() < 2.0
    assert hidden.visible[~under].mean() > 0.9
    picture, went = opened(texture, 1.5 * 7, LINE)
    again = tracker.update(frame(coloured(picture, 1.0, 8), 8), np.zeros_like(mask))
    assert again.visible[under].mean() > 0.8
    assert np.linalg.norm(again.points - went(points), axis=1)[again.visible].max() < 2.5


def test_a_point_hidden_too_long_is_lost_for_good() -> None:
    texture, points = speckle(4), grid_points()
    covered, free = np.ones(SIZE[::-1], dtype=bool), np.zeros(SIZE[::-1], dtype=bool)
    tracker = TrackerDIS(TrackerConfig(hidden=HiddenConfig(max_hidden=3)))
    tracker.start(frame(coloured(texture), 0), points)
    for k in range(1, 6):
        tracker.update(frame(coloured(texture), k), covered)
    assert not tracker.update(frame(coloured(texture), 9), free).visible.any()


def test_a_point_that_leaves_the_image_is_not_visible() -> None:
    texture = speckle(5)
    tracker = TrackerDIS()
    tracker.start(frame(coloured(texture), 0), np.array([[4.0, 100.0], [200.0, 100.0]]))
    for k in range(1, 5):
        tracks = tracker.update(frame(coloured(np.roll(texture, -2 * k, axis=1)), k))
    assert tracks.visible.tolist() == [False, True]
    assert tracks.points[1] == pytest.approx([192.0, 100.0], abs=0.5)


def test_another_picture_hides_all_points_as_long_as_it_lasts_and_they_come_back_with_their_own() -> None:
    texture, points = speckle(6), grid_points()
    tracker = TrackerDIS()
    tracker.start(frame(coloured(texture, 1.0, 0), 0), points, sides(points))
    for k in range(1, 4):
        before = tracker.update(frame(coloured(np.roll(texture, k, axis=1), 1.0, k), k))
    for k in range(4, 7):
        other = tracker.update(frame(coloured(speckle(7), 1.0, k), k))
        assert not other.visible.any()
        assert (other.confidence == 0).all()
        assert np.linalg.norm(other.points - before.points, axis=1).max() < 0.01
    for k in range(7, 10):
        back = tracker.update(frame(coloured(np.roll(texture, k, axis=1), 1.0, k), k))
    assert back.visible.mean() > 0.9
    assert np.linalg.norm(back.points - points - [9.0, 0.0], axis=1)[back.visible].max() < 2.5


def test_a_chained_tracker_does_not_see_its_points_in_another_picture() -> None:
    tracker = TrackerDIS(TrackerConfig(anchor=None))
    tracker.start(frame(coloured(speckle(6)), 0), grid_points())
    assert tracker.update(frame(coloured(speckle(7)), 1)).visible.mean() < 0.2


def test_nearly_flat_tissue_beside_a_new_cut_is_seen_again_after_the_tool_unless_it_is_dark_there() -> None:
    texture = speckle(10, contrast=0.1)
    points = np.array([[100.0, 112.0], [160.0, 112.0], [220.0, 112.0], [100.0, 128.0], [160.0, 128.0], [220.0, 128.0]])
    mask = np.zeros(SIZE[::-1], dtype=bool)
    mask[60:180, 140:180] = True
    tracker = TrackerDIS()
    tracker.start(frame(coloured(texture, 1.0, 0), 0), points, sides(points))
    for k in range(1, 9):
        picture, _ = opened(texture, 0.75 * k, LINE)
        covered = coloured(picture, 1.0, k)
        covered[mask] = (100, 102, 108)
        hidden = tracker.update(frame(covered, k), mask)
    assert not hidden.visible[[1, 4]].any()
    picture[125:140, 150:170] = 12.0
    again = tracker.update(frame(coloured(picture, 1.0, 9), 9), np.zeros_like(mask))
    assert again.visible[1]
    assert not again.visible[4]


def test_the_same_frame_twice_changes_nothing() -> None:
    texture = speckle(8)
    tracker = TrackerDIS()
    start = tracker.start(frame(coloured(texture), 5), grid_points())
    again = tracker.update(frame(coloured(texture), 5))
    assert np.array_equal(start.points, again.points)


def test_two_runs_give_identical_tracks() -> None:
    texture, points = speckle(9), grid_points()
    results = []
    for _ in range(2):
        tracker = TrackerDIS()
        tracker.start(frame(coloured(texture, 2.0, 0), 0), points)
        for k in range(1, 4):
            tracks = tracker.update(frame(coloured(opened(texture, 2.0 * k, LINE)[0], 2.0, k), k))
        results.append(tracks.points)
    assert np.array_equal(results[0], results[1])


def test_wrong_use_is_a_clear_error() -> None:
    tracker = TrackerDIS()
    with pytest.raises(RuntimeError, match="must be started"):
        tracker.update(frame(coloured(speckle(1)), 0))
    tracker.start(frame(coloured(speckle(1)), 0), grid_points())
    with pytest.raises(ValueError, match="one size"):
        tracker.update(frame(np.zeros((10, 10, 3), np.uint8), 1))
    with pytest.raises(ValueError, match="each point needs a group"):
        tracker.start(frame(coloured(speckle(1)), 0), grid_points(), np.zeros(3, np.int64))
    with pytest.raises(ValueError, match="preset"):
        TrackerConfig(preset="slow")
    with pytest.raises(ValueError, match="a pixel at least"):
        TrackerConfig(surroundings=0)
    with pytest.raises(ValueError, match="doubtful likeness below certain"):
        AnchorConfig(doubtful=0.9)
