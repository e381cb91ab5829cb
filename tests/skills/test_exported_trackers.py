"""Trackers from files: tiny networks exported to ONNX and with torch.export, and what is wrong with those that do not fit."""

import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from hardware.codes import InputError
from skills.tracking.choose import TrackerChoice, make_tracker
from skills.tracking.dis import TrackerFlow
from skills.tracking.exported import FlowExported, ModelExported, load_exported
from skills.tracking.learned import TrackerLearned
from tests.skills import onnx_files
from tests.skills.pictures import coloured, frame, speckle

POINTS = np.array([[90.0, 80.0], [110.0, 95.0], [150.5, 90.25], [130.0, 130.0], [170.0, 110.0], [200.0, 120.0], [180.0, 140.0]])


class Shift(torch.nn.Module):
    """Flow of one fixed shift."""

    def __init__(self, shift: tuple[float, float]) -> None:
        super().__init__()
        self.register_buffer("shift", torch.tensor(shift)[None, :, None, None])

    def forward(self, image1: torch.Tensor, image2: torch.Tensor) -> torch.Tensor:
        return self.shift + 0.0 * (image2 - image1)[:, :2]


class Where(torch.nn.Module):
    """Points that go by the mean change of red and green; the first channel decides whether they are seen."""

    def forward(self, frames: torch.Tensor, queries: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        change = (frames[:, 1] - frames[:, 0]).mean(dim=(2, 3))[:, None, :2]
        points = queries + change
        seen = (queries[..., 0] > 100).float()
        return points, seen, 0.5 + 0.25 * seen


def save(path: Path, module: torch.nn.Module, inputs: tuple[torch.Tensor, ...], dynamic: object = None) -> Path:
    torch.export.save(torch.export.export(module, inputs, dynamic_shapes=dynamic), path)
    return path


def flow_pt2(path: Path, size: tuple[int, int], free: bool, shift: tuple[float, float]) -> Path:
    images = torch.zeros(1, 3, *size), torch.zeros(1, 3, *size)
    sides = {2: torch.export.Dim("height", min=8), 3: torch.export.Dim("width", min=8)}
    return save(path, Shift(shift), images, (sides, sides) if free else None)


def flow_onnx(path: Path, size: tuple[int, int], free: bool, shift: tuple[float, float]) -> Path:
    return onnx_files.flow_model(path, (1, 3, "height", "width") if free else (1, 3, *size), shift)


@pytest.mark.parametrize(("write", "suffix"), [(flow_pt2, ".pt2"), (flow_onnx, ".onnx")])
@pytest.mark.parametrize("free", [True, False])
def test_a_flow_network_from_a_file_moves_the_points(
    write: Callable[[Path, tuple[int, int], bool, tuple[float, float]], Path], suffix: str, free: bool, tmp_path: Path
) -> None:
    path = write(tmp_path / f"flow{suffix}", (240, 320), free, (2.0, 1.0))
    flow = FlowExported(load_exported(path, "cpu"))
    pictures = (coloured(speckle(1, (133, 141))),) * 2
    assert flow.flow(*pictures).shape == (141, 133, 2)
    assert np.allclose(flow.flow(*pictures), [2.0, 1.0], atol=1e-5)


def test_a_fixed_size_smaller_than_the_picture_gives_flow_in_the_pictures_pixels(tmp_path: Path) -> None:
    flow = FlowExported(load_exported(flow_pt2(tmp_path / "flow.pt2", (128, 128), False, (2.0, 1.0)), "cpu"))
    pictures = (coloured(speckle(1, (256, 192))),) * 2
    assert np.allclose(flow.flow(*pictures), [4.0, 2.0], atol=1e-4)


def test_a_tracker_from_a_flow_file_does_not_believe_a_flow_that_the_picture_contradicts(tmp_path: Path) -> None:
    texture = speckle(3)
    still, wild = (
        make_tracker(TrackerChoice(str(flow_pt2(tmp_path / f"{k}.pt2", (128, 128), True, shift))))
        for k, shift in enumerate([(0.0, 0.0), (9.0, 5.0)])
    )
    assert isinstance(still, TrackerFlow)
    for tracker in (still, wild):
        tracker.start(frame(coloured(texture), 0), POINTS)
    seen = still.update(frame(coloured(texture), 1))
    assert seen.visible.all()
    assert seen.points == pytest.approx(POINTS, abs=0.01)
    # The way back of a flow that says (9, 5) both ways does not lead home, and what is there does not look alike.
    assert not wild.update(frame(coloured(texture), 1)).visible.any()


@pytest.mark.parametrize("count", [7, 3, "any"])
def test_a_point_network_from_an_onnx_file_takes_points_in_batches(count: int | str, tmp_path: Path) -> None:
    path = onnx_files.points_model(tmp_path / "points.onnx", (1, 2, 3, 240, 320), count, (1.5, -0.5))
    tracker = make_tracker(TrackerChoice(str(path)))
    assert isinstance(tracker, TrackerLearned)
    tracker.start(frame(coloured(speckle(1)), 0), POINTS)
    tracker.update(frame(coloured(speckle(1)), 1))
    tracks = tracker.update(frame(coloured(speckle(1)), 2))
    assert tracks.points == pytest.approx(POINTS + np.array([3.0, -1.0]), abs=1e-4)
    assert tracks.visible.all()
    assert tracks.confidence == pytest.approx(np.full(7, 0.75))


@pytest.mark.parametrize("size", [(240, 320), (120, 160), (256, 384), None])
def test_a_point_network_from_torch_export_sees_both_frames_at_the_size_it_takes(
    size: tuple[int, int] | None, tmp_path: Path
) -> None:
    given = torch.zeros(1, 2, 3, *(size or (64, 64))), torch.zeros(1, 4, 2)
    dynamic = None if size else ({3: torch.export.Dim.AUTO, 4: torch.export.Dim.AUTO}, {})
    model = ModelExported(load_exported(save(tmp_path / "points.pt2", Where(), given, dynamic), "cpu"))
    dark, light = np.zeros((240, 320, 3), np.uint8), np.zeros((240, 320, 3), np.uint8)
    light[..., 0], light[..., 1] = 6, 2
    model.start(dark, POINTS)
    points, visible, confidence = model.update(light)
    # The network moves points by (6, 2) of its own pixels.
    shrunk = min(1.0, size[0] / 240) if size else 1.0
    assert points == pytest.approx(POINTS + np.array([6.0, 2.0]) / shrunk, abs=1e-3)
    if shrunk == 1.0 and (size is None or size == (240, 320)):
        assert visible.tolist() == (POINTS[:, 0] > 100).tolist()
        assert confidence == pytest.approx(np.where(visible, 0.75, 0.5))


def test_onnxruntime_runs_the_file_where_it_is_installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = {}

    class Session:
        def __init__(self, path: str, providers: list[str]) -> None:
            asked["path"], asked["providers"] = path, providers

        def run(self, outputs: list[str], inputs: dict[str, np.ndarray]) -> list[np.ndarray]:
            assert outputs == ["flow"] and set(inputs) == {"image1", "image2"}
            return [np.full((1, 2, *inputs["image1"].shape[2:]), 5.0, np.float32)]

    runtime = SimpleNamespace(InferenceSession=Session, get_available_providers=lambda: ["CPUExecutionProvider"])
    monkeypatch.setitem(sys.modules, "onnxruntime", runtime)
    monkeypatch.setattr("skills.tracking.exported.find_spec", lambda name: name)
    path = onnx_files.flow_model(tmp_path / "flow.onnx", (1, 3, "h", "w"), (0.0, 0.0))
    image = coloured(speckle(1))
    assert (FlowExported(load_exported(path, "cpu")).flow(image, image) == 5.0).all()
    assert asked == {"path": str(path), "providers": ["CPUExecutionProvider"]}


def test_a_missing_file_and_one_of_another_kind_are_one_sentence(tmp_path: Path) -> None:
    for name, wrong in (("a.onnx", "is not an ONNX model"), ("a.pt2", "is not a file that torch.export.save wrote")):
        with pytest.raises(InputError, match="there is no model"):
            make_tracker(TrackerChoice(str(tmp_path / name)))
        (tmp_path / name).write_bytes(b"something else altogether")
        with pytest.raises(InputError, match=wrong):
            make_tracker(TrackerChoice(str(tmp_path / name)))


def test_another_signature_says_what_a_tracker_takes(tmp_path: Path) -> None:
    named = onnx_files.flow_model(tmp_path / "named.onnx", (1, 3, 64, 64), (0.0, 0.0), ("left", "right"))
    with pytest.raises(InputError, match="takes left, right and gives flow; a tracker takes image1 and image2"):
        load_exported(named, "cpu")
    shaped = onnx_files.flow_model(tmp_path / "shaped.onnx", (2, 3, 64, 64), (0.0, 0.0))
    with pytest.raises(InputError, match=r"input of shape \(2, 3, 64, 64\), not \(1, 3, any, any\)"):
        load_exported(shaped, "cpu")
    half = onnx_files.flow_model(tmp_path / "half.onnx", (1, 3, 64, "w"), (0.0, 0.0))
    with pytest.raises(InputError, match="must fix both or neither"):
        load_exported(half, "cpu")
    one = save(tmp_path / "one.pt2", torch.nn.Identity(), (torch.zeros(1, 3, 8, 8),))
    with pytest.raises(InputError, match="takes 1 inputs"):
        load_exported(one, "cpu")
