"""Where to leave the tissue: a flap that is pulled far hides what holds it, and what is hidden is neither judged nor cut."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skills.estimate.elongation import trusted
from skills.estimate.grid import Grid
from skills.estimate.look import Look

ENOUGH = 0.5


def last_in_sight(grid: Grid, looks: Sequence[Look], min_confidence: float, least: int) -> int:
    """The last step after which enough of the edges across the goal that have not been seen to part were in sight, with both ends.

    Enough is `ENOUGH` of as many as ever were at one time. `looks`, at least one, are in order. Not before step `least` if it can be
    helped. Openings seen on the way are remembered, so that nothing is lost by going back.
    """
    looks = [look for look in looks if look.step >= least] or list(looks[-1:])
    across = grid.edges[grid.crosses_goal]
    undecided = ~(looks[-1].bed[grid.crosses_goal] > 0.0)
    seen = np.array([trusted(look.tracks, min_confidence)[across].all(axis=1) for look in looks])
    count = (seen & undecided).sum(axis=1)
    return looks[int(np.flatnonzero(count >= ENOUGH * count.max())[-1])].step
