"""Which tracker follows the points: chosen by name, or by the file of an exported network (`--tracker`, `--tracker-weights`)."""

from __future__ import annotations

import contextlib
import io
from argparse import Namespace
from collections.abc import Callable
from dataclasses import dataclass, replace
from difflib import get_close_matches
from importlib import import_module
from pathlib import Path
from typing import Any

from hardware.codes import InputError
from skills.tracking.cotracker3 import ModelCoTracker3
from skills.tracking.dis import TrackerDIS, TrackerFlow
from skills.tracking.exported import SUFFIXES, FlowExported, ModelExported, load_exported
from skills.tracking.learned import TrackerLearned, fill, read_weights
from skills.tracking.litetracker import ModelLiteTracker
from skills.tracking.lk import TrackerLK
from skills.tracking.raft import FlowRAFT
from skills.tracking.stepwise import TrackerConfig
from skills.tracking.tracker import PointTracker

BUILT_IN = ("dis", "dis-chained", "lk")
UPSTREAM = ("litetracker", "cotracker3", "raft")

INSTALL = {
    "litetracker": "clone https://github.com/ImFusionGmbH/lite-tracker and put its folder on PYTHONPATH",
    "cotracker3": "pip install git+https://github.com/facebookresearch/co-tracker",
    "raft": "clone https://github.com/princeton-vl/RAFT and put its folder core on PYTHONPATH",
}
WEIGHTS = {
    "litetracker": "scaled_online.pth from https://huggingface.co/facebook/cotracker3",
    "cotracker3": "scaled_online.pth from https://huggingface.co/facebook/cotracker3",
    "raft": "raft-things.pth from the RAFT repository's download_models.sh",
}


@dataclass(frozen=True)
class TrackerChoice:
    """The tracker by name or by a file ending in .onnx or .pt2, its checkpoint, and the torch device it runs on; plain values.

    Raises:
        InputError: no such tracker, or weights that it cannot use.
    """

    kind: str = "dis"
    weights: str | None = None
    device: str = "cpu"

    def __post_init__(self) -> None:
        if not self.from_file and self.kind not in (*BUILT_IN, *UPSTREAM):
            near = get_close_matches(self.kind, (*BUILT_IN, *UPSTREAM), n=1)
            meant = f"; did you mean {near[0]}?" if near else ""
            names = ", ".join((*BUILT_IN, *UPSTREAM))
            raise InputError(f"there is no tracker {self.kind!r}: choose {names}, or a file ending in .onnx or .pt2{meant}")
        if self.weights is not None and self.kind not in UPSTREAM:
            raise InputError(f"the tracker {self.kind} takes no weights; only {', '.join(UPSTREAM)} do")

    @property
    def from_file(self) -> bool:
        """Whether the tracker is an exported network."""
        return Path(self.kind).suffix in SUFFIXES


def make_tracker(choice: TrackerChoice | None = None, config: TrackerConfig | None = None) -> PointTracker:
    """Make the tracker chosen; `config` is for those that go from frame to frame. Upstream packages are imported only here.

    Raises:
        InputError: its package is not installed, or its file is missing or not what it should be.
    """
    choice, config = choice or TrackerChoice(), config or TrackerConfig()
    if choice.kind == "dis":
        return TrackerDIS(config)
    if choice.kind == "dis-chained":
        return TrackerDIS(replace(config, anchor=None))
    if choice.kind == "lk":
        return TrackerLK(config)
    _check_device(choice)
    if choice.from_file:
        network = load_exported(Path(choice.kind), choice.device)
        return TrackerFlow(FlowExported(network), config) if network.gives_flow else TrackerLearned(ModelExported(network))
    make: dict[str, Callable[[TrackerChoice, TrackerConfig], PointTracker]] = {
        "litetracker": _litetracker,
        "cotracker3": _cotracker3,
        "raft": _raft,
    }
    return make[choice.kind](choice, config)


def _litetracker(choice: TrackerChoice, config: TrackerConfig) -> PointTracker:
    upstream, path = _upstream(choice, "src.lite_tracker", "LiteTracker"), _weights(choice)
    with contextlib.redirect_stdout(io.StringIO()):
        network = upstream()
    fill(network, read_weights(path, "LiteTracker"), path, "LiteTracker")
    return TrackerLearned(ModelLiteTracker(network, choice.device))


def _cotracker3(choice: TrackerChoice, config: TrackerConfig) -> PointTracker:
    upstream, path = _upstream(choice, "cotracker.predictor", "CoTrackerOnlinePredictor"), _weights(choice)
    predictor = upstream(checkpoint=None)
    fill(predictor.model, read_weights(path, "CoTracker3 online"), path, "CoTracker3 online")
    return TrackerLearned(ModelCoTracker3(predictor, choice.device))


def _raft(choice: TrackerChoice, config: TrackerConfig) -> PointTracker:
    upstream, path = _upstream(choice, "raft", "RAFT"), _weights(choice)
    weights = read_weights(path, "RAFT")
    # Only the full network has a mask to bring its flow to full size.
    small = not any(name.startswith("update_block.mask") for name in weights)
    network = upstream(Namespace(small=small, mixed_precision=False, alternate_corr=False, dropout=0))
    fill(network, weights, path, "RAFT")
    return TrackerFlow(FlowRAFT(network, choice.device), config)


def _upstream(choice: TrackerChoice, module: str, name: str) -> Any:
    """The upstream class; importing LiteTracker seeds torch's global generator, which is put back."""
    import torch

    try:
        with torch.random.fork_rng(devices=[]):
            return getattr(import_module(module), name)
    except (ImportError, AttributeError) as error:
        missing = getattr(error, "name", None)
        if isinstance(error, ModuleNotFoundError) and missing and not module.startswith(missing):
            raise InputError(f"the tracker {choice.kind} needs the package {missing}, which is not installed") from error
        raise InputError(f"the tracker {choice.kind} needs its upstream code: {INSTALL[choice.kind]}") from error


def _weights(choice: TrackerChoice) -> Path:
    if choice.weights is None:
        raise InputError(f"the tracker {choice.kind} needs a checkpoint: give --tracker-weights {WEIGHTS[choice.kind]}")
    path = Path(choice.weights)
    if not path.is_file():
        raise InputError(f"there is no checkpoint {path} for the tracker {choice.kind}: get {WEIGHTS[choice.kind]}")
    return path


def _check_device(choice: TrackerChoice) -> None:
    import torch

    try:
        device = torch.device(choice.device)
    except RuntimeError as error:
        raise InputError(f"torch knows no device {choice.device!r}: use cpu or cuda") from error
    if device.type == "cuda" and not torch.cuda.is_available():
        raise InputError("the tracker was asked to run on cuda, but torch sees no GPU here: use cpu")
