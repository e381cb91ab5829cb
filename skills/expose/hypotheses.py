"""What the pull would look like if the goal were severed, and if something still held it: the hypotheses, run beside each other.

Too much pull is as bad as too little: in the end what still holds stretches as far as a gap opens, and tears. The model is therefore
pulled along with the tissue in eight versions: all of the goal severed, all of it connected, what is believed now, and all severed but one
short strand, in five places along it. A strand left alone carries everything and stretches most: it is what a severed edge can be
mistaken for, and what tears.

Two things tell a severed edge from a connected one: how long it becomes, and the opening between the lips, which a strand never shows.
What is believed follows what is seen on the way: an edge that should gape by now and does not is still attached.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.interface import Array, CameraModel
from skills.estimate.grid import Grid, lengths
from skills.expose.model import TissueModel
from skills.expose.visibility import lips_of
from skills.expose.xpbd import BLOCK, State, XpbdConfig, XpbdSolver, rest_state
from skills.scene.surface import Surface
from skills.tracking.model_based import model_tracked_pixels, raycast

SEVERED, CONNECTED, BELIEVED, STRANDS = 0, 1, 2, slice(3, BLOCK)
DECIDED = 10.0  # standard deviations of what has been seen to part, or not to


@dataclass(frozen=True)
class SeparationConfig:
    """How well lengths are measured and predicted, and when two hypotheses are far enough apart."""

    strand: float = 1.5e-3  # [m] half the width of a strand
    pixel_error: float = 1.5  # [px], standard deviation of a tracked edge's length, and of the width of an opening
    model_error: float = 0.2  # of a predicted lengthening, relative
    quantile: float = 0.0  # of the edges; 0 asks for the hardest one too
    enough: float = 4.0  # standard deviations at that quantile
    parted: float = 1.5  # [px] of opening seen: the edge is severed
    expected: float = 6.0  # [px] of opening expected, and less than `parted` seen: the edge is attached

    def __post_init__(self) -> None:
        if not (
            self.strand > 0
            and self.pixel_error > 0
            and self.model_error >= 0
            and 0 <= self.quantile <= 1
            and self.enough > 0
            and 0 < self.parted < self.expected
        ):
            raise ValueError("the settings of the separation must be positive, and its quantile a share")


@dataclass(frozen=True)
class Stretch:
    """What is expected of the edges across the goal, (C,) each.

    `severed` and `connected` are the elongations under both hypotheses, `gap` [px] the opening if this edge is severed and the others are
    as believed, `apart` how many standard deviations that tells the hypotheses apart.
    """

    severed: Array
    connected: Array
    gap: Array
    apart: Array


class Hypotheses:
    """Pulls the eight versions of the model along. One thread."""

    def __init__(
        self,
        model: TissueModel,
        surface: Surface,
        grid: Grid,
        camera: CameraModel,
        config: SeparationConfig,
        xpbd: XpbdConfig,
        device: str,
    ) -> None:
        self._model = model
        self._camera = camera
        self._config = config
        self._solver = XpbdSolver(model, BLOCK, 1, xpbd, device, threads=1)
        joined = _joined(model, surface, config.strand)
        rest = rest_state(model)
        rows = (BLOCK, *rest.positions.shape[1:])
        self.state = State(np.broadcast_to(rest.positions, rows).copy(), np.repeat(rest.adhesion, BLOCK, axis=0), joined)
        self.tension = np.zeros(BLOCK)
        self.strain = np.zeros(BLOCK)
        self.edges = np.flatnonzero(grid.crosses_goal)
        self._grid = grid
        self._points = raycast(grid.points, surface.vertices, surface.triangles, camera)
        before = lengths(grid.points, grid.edges[self.edges])
        self._before = np.minimum(before, grid.closed_length)
        self._nearest = self._strand_edges()
        ends = grid.points[grid.edges[self.edges]]
        sides = np.where(grid.near_side[grid.edges[self.edges, 0]], 1.0, -1.0)[:, None]
        across = (ends[:, 0] - ends[:, 1]) * sides
        self._across = across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)
        self._lips = lips_of(surface, model.seams)
        self._station = grid.station[self.edges] * surface.goal_length
        self._attached = np.zeros(len(self.edges), dtype=bool)
        self._parted = np.zeros(len(self.edges), dtype=bool)
        # Each seam holds as the edge across the goal next to it.
        self._edge_of_seam = np.abs(model.seam_station[:, None] - grid.station[self.edges][None]).argmin(axis=1)

    def one(self, index: int) -> State:
        """The state of one version, to plan from."""
        s = self.state
        return State(s.positions[index : index + 1], s.adhesion[index : index + 1], s.joined[index : index + 1])

    def advance(self, displacement: Array) -> None:
        """Move the jaws by `displacement` (3,) [m] in all versions."""
        rollout = self._solver.rollout(self.state, np.broadcast_to(displacement, (BLOCK, 1, 3)))
        self.tension = np.asarray(rollout.tension[0], dtype=np.float64)
        self.strain = np.asarray(rollout.strain[0], dtype=np.float64)
        self.state = rollout.final()

    def see(self, gaps: Array) -> None:
        """Take in the widest openings (E,) [px] seen along the grid's edges so far; nan where none could be looked for."""
        seen = gaps[self.edges]
        self._parted |= np.nan_to_num(seen) >= self._config.parted
        due = np.isfinite(seen) & (self._gap(BELIEVED) >= self._config.expected)
        self._attached = (self._attached | due) & ~self._parted
        self.state.joined[BELIEVED] = self._attached[self._edge_of_seam]

    def stretch(self) -> Stretch:
        """Expected elongation of the edges across the goal, now; nan where an end is off the mesh."""
        pixels = model_tracked_pixels(self._points, self.state.positions.astype(np.float64), self._model.triangles, self._camera)
        ends = self._grid.edges[self.edges]
        rho = np.linalg.norm(pixels[:, ends[:, 0]] - pixels[:, ends[:, 1]], axis=2) / self._before
        strand = rho[STRANDS][np.arange(len(self._nearest)), self._nearest]
        station = self._grid.station[self.edges]
        seen = np.isfinite(strand)  # a strand's edge may lie off the mesh, at the goal's ends
        alone = np.interp(station, station[self._nearest][seen], strand[seen]) if seen.any() else np.full(len(station), np.nan)
        severed, connected = rho[SEVERED], np.maximum(rho[CONNECTED], alone)
        c = self._config
        grown = np.abs(np.stack([severed, connected]) - 1.0) * self._before
        sigma = np.sqrt(c.pixel_error**2 + (c.model_error**2) * (grown**2).sum(axis=0))
        gap = self._gap(BELIEVED)
        longer = (severed - connected) * self._before / sigma
        decided = self._parted | self._attached
        apart = np.where(decided, np.inf, np.fmax(longer, gap / c.pixel_error))
        return Stretch(severed, connected, gap, np.minimum(apart, DECIDED))

    def _gap(self, version: int) -> Array:
        """Width (C,) [px] of the opening at each edge in a version of the model; below 0 where the lips overlap."""
        positions = self.state.positions[version].astype(np.float64)
        near, far = (self._camera.project(positions[lip]) for lip in (self._lips.near, self._lips.far))
        apart = np.column_stack([np.interp(self._station, self._lips.station, (near - far)[:, k]) for k in (0, 1)])
        return np.asarray((apart * self._across).sum(axis=1))

    def separation(self, stretch: Stretch) -> float:
        """Standard deviations that all but the hardest edges reach; 0 when nothing is known."""
        known = stretch.apart[np.isfinite(stretch.apart)]
        return float(np.quantile(known, self._config.quantile)) if len(known) else 0.0

    def _strand_edges(self) -> NDArray[np.int64]:
        """For each strand the edge across the goal that lies on it; strands in order along the goal."""
        station = self._grid.station[self.edges]
        return np.array([int(np.argmin(np.abs(station - centre))) for centre in _centres()])


def _centres() -> Array:
    """Stations 0..1 of the strands."""
    count = STRANDS.stop - STRANDS.start
    return (np.arange(count) + 0.5) / count


def _joined(model: TissueModel, surface: Surface, half_width: float) -> NDArray[np.float32]:
    """Which seams hold in each version, (8, S)."""
    line = np.linalg.norm(np.diff(model.rest[model.seams[:, 0]], axis=0), axis=1).sum() / max(
        float(np.ptp(model.seam_station)), 1e-9
    )
    joined = np.zeros((BLOCK, len(model.seams)), np.float32)
    joined[CONNECTED] = 1.0
    for row, centre in zip(joined[STRANDS], _centres(), strict=True):
        off = np.abs(model.seam_station - centre) * line
        row[off <= half_width] = 1.0
        row[int(np.argmin(off))] = 1.0
    return joined
