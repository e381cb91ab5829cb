"""The adapters to the paper's trackers, beside stand-ins with the upstream interfaces."""

import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from skills.tracking.choose import TrackerChoice, make_tracker
from skills.tracking.dis import TrackerFlow
from skills.tracking.learned import TrackerLearned
from tests.skills import upstream
from tests.skills.pictures import coloured, frame, speckle

POINTS = np.array([[60.0, 70.0], [150.5, 90.25], [200.0, 120.0]])


def marked(k: int) -> np.ndarray:
    """A dim picture with one bright pixel that goes (2, 1) pixels a frame."""
    image = coloured(speckle(1, contrast=0.1))
    image[40 + k, 50 + 2 * k] = 255
    return image


@pytest.fixture
def lite(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "src", upstream.module("src"))
    monkeypatch.setitem(sys.modules, "src.lite_tracker", upstream.module("src.lite_tracker", LiteTracker=upstream.LiteTracker))


@pytest.fixture
def cotracker(monkeypatch: pytest.MonkeyPatch) -> None:
    predictor = upstream.module("cotracker.predictor", CoTrackerOnlinePredictor=upstream.CoTrackerOnlinePredictor)
    monkeypatch.setitem(sys.modules, "cotracker", upstream.module("cotracker"))
    monkeypatch.setitem(sys.modules, "cotracker.predictor", predictor)


@pytest.fixture
def raft(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "raft", upstream.module("raft", RAFT=upstream.RAFT))


def checkpoint(path: Path, weights: dict[str, torch.Tensor]) -> str:
    torch.save(weights, path)
    return str(path)


@pytest.mark.usefixtures("lite")
def test_litetracker_gives_what_the_network_gives_for_every_frame(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    weights = checkpoint(tmp_path / "w.pth", {"model": {"gain": torch.ones(1)}})
    tracker = make_tracker(TrackerChoice("litetracker", weights))
    for video in range(2):
        tracker.start(frame(marked(video), 0), POINTS)
        for k in range(1, 5):
            tracks = tracker.update(frame(marked(video + k), k))
        assert tracks.points == pytest.approx(POINTS + np.array([8.0, 4.0]), abs=1e-4)
    assert tracks.visible.tolist() == [True, True, False]
    assert tracks.confidence == pytest.approx([0.8, 0.8, 0.0], abs=1e-6)
    assert capsys.readouterr().out == ""


@pytest.mark.usefixtures("cotracker")
def test_cotracker3_gives_a_result_for_every_frame_and_moves_on_as_upstream_does(tmp_path: Path) -> None:
    tracker = make_tracker(TrackerChoice("cotracker3", checkpoint(tmp_path / "w.pth", {"gain": torch.ones(1)})))
    assert isinstance(tracker, TrackerLearned)
    tracker.start(frame(marked(0), 0), POINTS)
    confidence = []
    for k in range(1, 34):
        tracks = tracker.update(frame(marked(k), k))
        assert tracks.points == pytest.approx(POINTS + np.array([2.0, 1.0]) * k, abs=1e-4)
        confidence.append(float(tracks.confidence[0]))
    network = tracker._model._predictor.model  # type: ignore[attr-defined]
    # Every window ends at the newest frame; only full ones are kept, those of 16, 24 and 32 frames.
    assert network.ends == list(range(2, 35))
    assert network.online_ind == 24
    assert network.online_coords_predicted.shape[1] == 32
    assert [k + 2 for k, sure in enumerate(confidence) if sure == 1.0] == [16, 24, 32]
    assert set(confidence) == {0.75, 1.0}


@pytest.mark.usefixtures("raft")
@pytest.mark.parametrize("small", [True, False])
def test_raft_is_padded_tells_its_size_from_the_checkpoint_and_moves_the_points(small: bool, tmp_path: Path) -> None:
    weights = {"module.gain": torch.ones(1)}
    if not small:
        weights |= {"module.update_block.mask.0.weight": torch.ones(1, 1, 1, 1), "module.update_block.mask.0.bias": torch.ones(1)}
    tracker = make_tracker(TrackerChoice("raft", checkpoint(tmp_path / "w.pth", weights)))
    assert isinstance(tracker, TrackerFlow)
    texture = speckle(2, contrast=0.5)
    tracker.start(frame(moved(texture, 0), 0), POINTS)
    for k in range(1, 4):
        tracks = tracker.update(frame(moved(texture, k), k))
    assert tracks.points == pytest.approx(POINTS + np.array([6.0, 3.0]), abs=0.1)
    assert tracks.visible.all()


def moved(texture: np.ndarray, k: int) -> np.ndarray:
    """A texture that goes (2, 1) pixels a frame, with its bright mark between the points."""
    image = np.minimum(coloured(np.roll(texture, (k, 2 * k), axis=(0, 1))), 240)
    image[95 + k, 120 + 2 * k] = 255
    return image


@pytest.mark.usefixtures("lite")
def test_what_a_tool_covers_and_what_is_not_finite_is_not_seen(tmp_path: Path) -> None:
    tracker = make_tracker(TrackerChoice("litetracker", checkpoint(tmp_path / "w.pth", {"gain": torch.ones(1)})))
    mask = np.zeros((240, 320), dtype=bool)
    mask[60:80, 50:75] = True
    started = tracker.start(frame(marked(0), 0), POINTS, tool_mask=mask)
    assert started.visible.tolist() == [False, True, True]
    covered = tracker.update(frame(marked(1), 1), mask)
    assert covered.visible.tolist() == [False, True, False]
    assert covered.confidence[0] == 0.0
    tracker._model._network.gain.data[:] = float("nan")  # type: ignore[attr-defined]
    lost = tracker.update(frame(marked(2), 2))
    assert not lost.visible.any()
    assert lost.points == pytest.approx(covered.points)


@pytest.mark.usefixtures("lite")
def test_the_same_frame_twice_and_wrong_use_are_like_those_of_any_tracker(tmp_path: Path) -> None:
    tracker = make_tracker(TrackerChoice("litetracker", checkpoint(tmp_path / "w.pth", {"gain": torch.ones(1)})))
    with pytest.raises(RuntimeError, match="must be started"):
        tracker.update(frame(marked(0), 0))
    tracker.start(frame(marked(0), 5), POINTS)
    assert np.array_equal(tracker.update(frame(marked(3), 5)).points, POINTS)
    with pytest.raises(ValueError, match="one size"):
        tracker.update(frame(np.zeros((10, 10, 3), np.uint8), 6))
    with pytest.raises(ValueError, match="each point needs a group"):
        tracker.start(frame(marked(0), 7), POINTS, np.zeros(1, np.int64))
