"""Where to leave the tissue: a flap that is pulled far hides what holds it, and what is hidden is neither judged nor cut."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skills.estimate.elongation import trusted
from skills.estimate.grid import Grid
from skills.estimate.look import Look


def best_in_sight(grid: Grid, looks: Sequence[Look], min_confidence: float, least: int) -> int:
    """The last step after which both ends were in sight of most edges across the goal that have not been seen to part.

    `looks`, at least one, are in order. Not before step `least` if it can be helped. Openings seen on the way are remembered, so that
    nothing is lost by going back.
    """
    looks = [look for look in looks if look.step >= least] or list(looks[-1:])
    across = grid.edges[grid.crosses_goal]
    undecided = ~(looks[-1].bed[grid.crosses_goal] > 0.0)
    seen = np.array([trusted(look.tracks, min_confidence)[across].all(axis=1) for look in looks])
    count = (seen & undecided).sum(axis=1)
    return looks[len(looks) - 1 - int(np.argmax(count[::-1]))].step
