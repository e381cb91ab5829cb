"""What live views and the record take from the exposure controller: whether it pulls, a line in words, a few of its sampled paths."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from behaviours.board import Step
from hardware.interface import Array
from supervisor.snapshot import NodeState

if TYPE_CHECKING:
    from skills.expose.optimal import View

SHOWN_PATHS = 16  # of the sampled ones: enough to see where they spread


def is_exposing(nodes: Sequence[NodeState]) -> bool:
    """Whether the tissue is being pulled now."""
    return any(node.name == Step.EXPOSE and node.status == "RUNNING" for node in nodes)


def in_words(view: View) -> str:
    """One short line: which step, how much of the cut is expected to open at what tension, how far apart the hypotheses are."""
    if not math.isfinite(view.opening):
        return f"step {view.number}, no plan"
    tension = f"{view.tension:.2f} N" if math.isfinite(view.tension) else "tension unknown"
    return f"step {view.number}, {view.opening:.0f} px² open, {tension}, {view.separation:.1f} SD apart"


def some_paths(view: View) -> Array:
    """At most `SHOWN_PATHS` of the sampled paths (N, h + 1, 3) [m], evenly chosen."""
    count = len(view.paths)
    return view.paths[np.linspace(0, count - 1, min(SHOWN_PATHS, count)).round().astype(np.intp)]
