"""The Lucas-Kanade tracker on warped speckle: it shares what hides a point with the DIS tracker, and follows each point by itself."""

import numpy as np

from skills.tracking.lk import TrackerLK
from tests.skills.pictures import SIZE, coloured, frame, opened, speckle

LINE = 120.0


def grid_points() -> np.ndarray:
    u, v = np.meshgrid(np.arange(90.0, 231.0, 20.0), [90.0, 104.0, 136.0, 150.0])
    return np.column_stack([u.ravel(), v.ravel()])


def test_points_follow_a_stretch_and_an_opening_to_within_a_pixel() -> None:
    texture, points = speckle(1), grid_points()
    tracker = TrackerLK()
    tracker.start(frame(coloured(texture, 1.0, 0), 0), points, (points[:, 1] > LINE).astype(np.int64))
    for k in range(1, 11):
        picture, went = opened(texture, 2.0 * k, LINE, 0.003 * k)
        tracks = tracker.update(frame(coloured(picture, 1.0, k), k))
    error = np.linalg.norm(tracks.points - went(points), axis=1)
    assert np.median(error) < 1.0
    assert tracks.visible.mean() > 0.9
    assert tracks.confidence[tracks.visible].mean() > 0.7


def test_a_point_under_a_tool_goes_with_its_side_and_is_found_again() -> None:
    texture, points = speckle(3), grid_points()
    mask = np.zeros(SIZE[::-1], dtype=bool)
    mask[80:118, 135:165] = True
    under = mask[points[:, 1].astype(int), points[:, 0].astype(int)]
    tracker = TrackerLK()
    tracker.start(frame(coloured(texture, 1.0, 0), 0), points, (points[:, 1] > LINE).astype(np.int64))
    for k in range(1, 7):
        picture, went = opened(texture, 1.5 * k, LINE)
        image = coloured(picture, 1.0, k)
        image[mask] = (100, 102, 108)
        hidden = tracker.update(frame(image, k), mask)
    assert not hidden.visible[under].any()
    assert (hidden.confidence[under] == 0).all()
    assert np.linalg.norm(hidden.points - went(points), axis=1)[under].max() < 2.0
    picture, went = opened(texture, 10.5, LINE)
    again = tracker.update(frame(coloured(picture, 1.0, 8), 8), np.zeros_like(mask))
    assert again.visible[under].mean() > 0.8


def test_another_picture_hides_the_points() -> None:
    tracker = TrackerLK()
    tracker.start(frame(coloured(speckle(6)), 0), grid_points())
    assert tracker.update(frame(coloured(speckle(7)), 1)).visible.mean() < 0.2


def test_no_points_are_followed_without_complaint() -> None:
    tracker = TrackerLK()
    tracker.start(frame(coloured(speckle(6)), 0), np.zeros((0, 2)))
    assert len(tracker.update(frame(coloured(speckle(7)), 1)).points) == 0
