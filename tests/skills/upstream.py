"""Stand-ins with the interfaces of the upstream trackers: small torch modules that follow a known shift, and count their calls."""

from __future__ import annotations

from argparse import Namespace
from types import ModuleType

import torch


def module(name: str, **members: object) -> ModuleType:
    """A module to be put into sys.modules."""
    made = ModuleType(name)
    for key, value in members.items():
        setattr(made, key, value)
    return made


def brightest(image: torch.Tensor) -> torch.Tensor:
    """(u, v) of the brightest pixel of an image (3, H, W)."""
    total = image.sum(dim=0)
    at = int(total.argmax())
    return torch.tensor([float(at % total.shape[1]), float(at // total.shape[1])])


class LiteTracker(torch.nn.Module):
    """model(frame (B, 3, H, W), queries (B, N, 3)) -> coords (B, 1, N, 2), visible (B, 1, N), confidence (B, 1, N)."""

    def __init__(self) -> None:
        super().__init__()
        self.gain = torch.nn.Parameter(torch.zeros(1))
        self.reset()

    def reset(self) -> None:
        self.online_ind = 0
        print("All the caches are reset.")

    def forward(self, frame: torch.Tensor, queries: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        mark = brightest(frame[0])
        if self.online_ind == 0:
            self.first = mark
        self.online_ind += 1
        coords = queries[:, None, :, 1:] + self.gain * (mark - self.first)
        confidence = torch.full(coords.shape[:-1], 0.8)
        confidence[..., -1] = 0.3
        return coords, confidence > 0.6, confidence


class OnlineNetwork(torch.nn.Module):
    """What CoTracker3's online network remembers: how far its window has come, and the tracks so far."""

    def __init__(self) -> None:
        super().__init__()
        self.gain = torch.nn.Parameter(torch.zeros(1))
        self.window_len = 16
        self.ends: list[int] = []

    def init_video_online_processing(self) -> None:
        self.online_ind = 0
        self.online_coords_predicted = None
        self.ends = []

    def forward(self, video: torch.Tensor, queries: torch.Tensor) -> torch.Tensor:
        length = video.shape[1]
        assert length <= self.window_len, "a chunk is one window at most"
        if self.online_ind == 0:
            self.first = brightest(video[0, 0])
        assert self.online_ind == 0 or self.online_coords_predicted is not None
        marks = torch.stack([brightest(image) for image in video[0]])
        window = queries[:, None, :, 1:] + self.gain * (marks - self.first)[None, :, None]
        before = window[:, :0] if self.online_coords_predicted is None else self.online_coords_predicted[:, : self.online_ind]
        self.ends.append(self.online_ind + length)
        self.online_ind += self.window_len // 2
        self.online_coords_predicted = torch.cat([before, window], dim=1)
        return self.online_coords_predicted


class CoTrackerOnlinePredictor(torch.nn.Module):
    """First call stores the queries and gives (None, None); then the history (B, T, N, 2) and visible (B, T, N)."""

    def __init__(self, checkpoint: str | None = None, window_len: int = 16) -> None:
        super().__init__()
        self.model = OnlineNetwork()
        self.step = window_len // 2

    def forward(
        self, video_chunk: torch.Tensor, is_first_step: bool = False, queries: torch.Tensor | None = None
    ) -> tuple[torch.Tensor | None, torch.Tensor | None]:
        if is_first_step:
            self.model.init_video_online_processing()
            self.queries = queries
            return None, None
        tracks = self.model(video_chunk, self.queries)
        return tracks, torch.ones(tracks.shape[:-1], dtype=torch.bool)


class RAFT(torch.nn.Module):
    """forward(image1, image2, iters, test_mode) -> (flow at 1/8, flow (N, 2, H, W)): the shift of the brightest pixel, times gain."""

    def __init__(self, args: Namespace) -> None:
        super().__init__()
        self.small = args.small
        assert "dropout" in args and not args.alternate_corr and not args.mixed_precision
        self.gain = torch.nn.Parameter(torch.zeros(1))
        if not args.small:
            self.update_block = torch.nn.ModuleDict({"mask": torch.nn.Sequential(torch.nn.Conv2d(1, 1, 1))})

    def forward(
        self, image1: torch.Tensor, image2: torch.Tensor, iters: int = 12, test_mode: bool = False
    ) -> tuple[torch.Tensor, torch.Tensor]:
        height, width = image1.shape[-2:]
        assert height % 8 == 0 and width % 8 == 0 and min(height, width) >= 128 and iters > 1 and test_mode
        shift = self.gain * (brightest(image2[0]) - brightest(image1[0]))
        flow = shift[None, :, None, None].expand(1, 2, height, width)
        return flow[..., ::8, ::8] / 8, flow
