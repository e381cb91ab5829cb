"""Points followed by dense flow: chained from frame to frame, and anchored to a reference frame so that the chain does not drift.

Flow is computed only in the box around the points, forwards and backwards. A reference that no longer holds, because most of what it
showed has changed, is replaced by the frame at hand.
"""

from __future__ import annotations

import numpy as np

from hardware.interface import Array
from skills.tracking.anchor import Anchor
from skills.tracking.flow import Flow, FlowBox, FlowDIS, box_around, cut_out
from skills.tracking.hidden import Mask, covered, inside
from skills.tracking.picture import Picture
from skills.tracking.stepwise import TrackerConfig, TrackerStepwise

MIN_POINTS = 6  # seen on one side, for it to have a reference


class TrackerFlow(TrackerStepwise):
    """Follows points by any dense `flow`; `config.anchor` None leaves it chained."""

    def __init__(self, flow: Flow, config: TrackerConfig | None = None) -> None:
        super().__init__(config)
        self._flow = flow

    def _begin(self, tool_mask: Mask | None) -> None:
        self._step = FlowBox(np.zeros(2), np.zeros((1, 1, 2), np.float32))
        self._anchors: dict[int, Anchor] = {}
        self._held = np.zeros(len(self._points), dtype=bool)
        for group in np.unique(self._groups):
            self._take_reference(int(group), self._picture, self._points, self._seen, tool_mask)

    def _follow(self, new: Picture) -> tuple[Array, Array]:
        alive = self._points[self._hidden_for <= self.config.hidden.max_hidden]
        if not len(alive):
            return self._points.copy(), np.full(len(self._points), np.inf)
        height, width = new.grey.shape
        box = box_around(alive, self.config.margin, (width, height))
        a, b = (cut_out(self._flow.sees(picture), box) for picture in (self._picture, new))
        corner = np.array(box[:2], dtype=np.float64)
        # The anchor takes out what a quick flow leaves.
        forth = self._flow.flow if self.config.anchor is None else self._flow.near
        self._step, back = FlowBox(corner, forth(a, b)), FlowBox(corner, self._flow.check(b, a))
        step = self._step.at(self._points)
        moved = self._points + step
        return moved, np.linalg.norm(step + back.at(moved), axis=1)

    def _looked_after(self) -> Mask:
        return self._held & ~self._seen

    def _settle(self, new: Picture, moved: Array, seen: Mask, found: Mask, tool_mask: Mask | None) -> tuple[Array, Array]:
        config, settled, agreement = self.config.anchor, moved.copy(), np.full(len(moved), np.nan)
        if config is None:
            return settled, agreement
        self._held = np.zeros(len(moved), dtype=bool)
        for group in np.unique(self._groups):
            mine = self._groups == group
            anchor = self._anchors.get(int(group))
            followed, before = int((seen & ~found & mine).sum()), int((self._seen & mine).sum())
            if anchor is not None:
                places, alike = anchor.follow(new, self._step, moved[mine], found[mine], tool_mask)
                in_view = inside(places, new.grey) & ~covered(places, tool_mask)
                least = config.min_holding if followed >= config.min_followed * max(before, 1) else config.min_returned
                # A side that a tool hides keeps its reference: it will be seen again.
                if in_view.sum() < MIN_POINTS or anchor.holding(alike[in_view]) >= least:
                    settled[mine], agreement[mine], self._held[mine] = places, alike, True
                    continue
            if followed >= max(MIN_POINTS, config.min_renewing * before):
                self._take_reference(int(group), new, moved, seen, tool_mask)
            elif anchor is not None:
                # Neither the reference nor the frame before: a picture of something else, or a blurred one. Points wait where they were.
                anchor.let_go()
                settled[mine], agreement[mine] = self._points[mine], 0.0
        return settled, agreement

    def _take_reference(self, group: int, picture: Picture, points: Array, seen: Mask, tool_mask: Mask | None) -> None:
        """Anchor one side to `picture`; without enough of it in sight it has no reference."""
        self._anchors.pop(group, None)
        mine = self._groups == group
        if self.config.anchor is not None and (mine & seen).sum() >= MIN_POINTS:
            self._anchors[group] = Anchor(picture, self._flow, points, mine, seen, tool_mask, self.config.anchor)


class TrackerDIS(TrackerFlow):
    """The default tracker: DIS flow on pictures of even contrast, chained and anchored."""

    def __init__(self, config: TrackerConfig | None = None) -> None:
        config = config or TrackerConfig()
        super().__init__(FlowDIS(config.preset), config)
