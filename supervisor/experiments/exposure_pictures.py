"""Pictures of the exposure experiment: what the camera sees at the end of each method's pull, side by side."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from hardware.codes import InputError
from hardware.interface import Image

WIDE, HIGH, STRIP, GAP = 480, 360, 62, 6  # [px] of a panel, its caption, and between panels
IN_A_ROW = 4
FONT = cv2.FONT_HERSHEY_DUPLEX
TITLES = {
    "naive_normal": "naive: towards the grasp",
    "goal_normal": "across the goal",
    "optimal_full": "planned, without its stop rule",
    "optimal": "planned, with its stop rule",
    "paper_losses": "paper's losses only",
    "no_camera": "without camera loss",
    "no_expanding": "without expanding loss",
    "no_smoothing": "without smoothing",
    "half_samples": "half the samples",
    "horizon_1": "horizon of one step",
}


def panel_path(folder: Path, seed: int, method: str) -> Path:
    """Where the picture of one run is kept."""
    return folder / f"seed{seed}-{method}.png"


def write_panel(path: Path, image: Image) -> None:
    """Write `image` (H, W, 3) uint8 RGB as PNG.

    Raises:
        InputError: it cannot be written.
    """
    if not cv2.imwrite(str(path), cv2.cvtColor(image, cv2.COLOR_RGB2BGR)):
        raise InputError(f"the picture {path} cannot be written")


def side_by_side(folder: Path, trial: dict[str, dict[str, Any]]) -> Path:
    """Join the panels of one seed, runs by method, with a caption below each; gives the file that was written."""
    panels = [_panel(folder, method, run) for method, run in trial.items()]
    panels += [np.full_like(panels[0], 255)] * (-len(panels) % IN_A_ROW if len(panels) > IN_A_ROW else 0)
    rows = [_joined(panels[k : k + IN_A_ROW], 1) for k in range(0, len(panels), IN_A_ROW)]
    path = folder / f"seed{next(iter(trial.values()))['seed']}.png"
    write_panel(path, _joined(rows, 0))
    return path


def _panel(folder: Path, method: str, run: dict[str, Any]) -> NDArray[np.uint8]:
    """One picture (HIGH + STRIP, WIDE, 3) RGB with its caption; grey when nothing was pulled."""
    panel = np.full((HIGH + STRIP, WIDE, 3), 255, dtype=np.uint8)
    path = panel_path(folder, run["seed"], method)
    image = cv2.imread(str(path)) if run["curve"] else None
    if image is None:
        panel[:HIGH] = 160
        said = "nothing was pulled"
    else:
        panel[:HIGH] = cv2.resize(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), (WIDE, HIGH), interpolation=cv2.INTER_AREA)
        last = run["curve"][-1]
        said = f"{last['area_px']} px of the cut seen, {last['step']} steps, {last['tension_n']:.1f} N"
    for text, down, size, grey in ((TITLES.get(method, method), 24, 0.62, 30), (said, 50, 0.52, 90)):
        cv2.putText(panel, text, (8, HIGH + down), FONT, size, (grey, grey, grey), 1, cv2.LINE_AA)
    return panel


def _joined(parts: list[NDArray[np.uint8]], axis: int) -> NDArray[np.uint8]:
    """Side by side (axis 1) or below each other (axis 0), with white between."""
    shape = list(parts[0].shape)
    shape[axis] = GAP
    gap = np.full(shape, 255, dtype=np.uint8)
    between = [part for piece in parts for part in (gap, piece)][1:]
    return np.concatenate(between, axis=axis)
