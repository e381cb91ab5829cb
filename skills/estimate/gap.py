"""How wide an opening lies along each edge of the keypoint grid: what is dark between two lips is no tissue.

Seen at full resolution, a slit of two pixels counts; a mask of the whole picture is made coarser and loses it. A slit is shallow at first
and its cut faces are lit, so it is only a little darker than the tissue; vessels and prints are that dark too, but they were there at
t_d already. So the reference picture tells how dark an edge may be; the one that the goal was drawn on, whether that was a vessel or a cut.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from hardware.interface import Array, Image
from skills.estimate.strand import strands_between
from skills.tracking.median import median

LEVEL_WINDOW = 7  # edges, of the running median of how bright the tissue at their ends was at t_d
STILL_AS_BRIGHT = 0.8  # of that, times what became of the light: what is darker has come to lie in the opening


@dataclass(frozen=True)
class GapConfig:
    """What counts as an opening in the brightness profile along an edge. Brightness as a share of that at the edge's ends.

    The shares are where connected edges ended on the bench's three tissues: none fell below 0.98 (chicken) or 0.70 (beef, vessels), none
    lost more than 0.055 of its darkest place while it was stretched.
    """

    sample: float = 0.5  # [px] between samples
    least_samples: int = 16
    end: float = 0.15  # share of the edge at each end that tells the tissue's brightness,
    longest_end: float = 4.0  # [px] and no more than this, where the lips of a wide opening may end
    dark: float = 0.65  # below this it is an opening whatever was there before
    faint: float = 0.94  # below this it is one where the tissue was evenly bright before
    fainter: float = 0.92  # of the darkest place that was there before
    bed: float = 0.62  # below this it is the bed: it was at 0.5 or less, cut faces and floors of grooves at 0.77 or more


def gap_along(
    image: Image,
    points: Array,
    edges: NDArray[np.int64],
    config: GapConfig | None = None,
    darkest_before: Array | None = None,
    least_level: Array | None = None,
) -> Array:
    """Width (E,) [px] of the longest dark run along each edge between `points` (N, 2) on `image` (H, W, 3) uint8 RGB.

    nan where an end is not on the image. `darkest_before` (E,) from `darkest_along` at t_d lets faint slits count too. `least_level` (E,)
    [grey levels] is how bright tissue is there at least: where an end itself has come to lie in the opening, it does not tell.
    """
    config = config or GapConfig()
    dark = config.dark if darkest_before is None else _dark(darkest_before, config)
    return _width_below(dark, _profiles(_brightness(image), points, edges, config), least_level)


def darkest_along(image: Image, points: Array, edges: NDArray[np.int64], config: GapConfig | None = None) -> Array:
    """Brightness (E,) of the darkest place along each edge, as a share of that at its ends; nan where an end is not on the image."""
    return _darkest(_profiles(_brightness(image), points, edges, config or GapConfig()))


class GapWatch:
    """The widest opening seen along each edge since t_d, in two looks in a row: what has parted does not heal.

    A slit may be open at t_d and close again while the tissue beside it is pulled; only somebody who looked all the time knows.
    """

    def __init__(
        self,
        image: Image,
        points: Array,
        edges: NDArray[np.int64],
        crosses_goal: NDArray[np.bool_],
        between: tuple[float, ...] = (),
        darkest_before: Array | None = None,
    ) -> None:
        """`between` are places beside each edge across the goal, in spacings towards the next one, that must be open too.

        Strands are thinner than the grid. The edges across the goal come in order along it. `darkest_before` (E,) is what `darkest_along`
        gave around each edge when the goal was drawn, nan where not known: what has become darker by t_d is no vessel but a slit.
        """
        self._edges = edges
        self._config = GapConfig()
        crossing = np.flatnonzero(crosses_goal)
        # Apart from each other, since those across the goal become long: a profile has as many samples as the longest one needs.
        places = ((0.0, np.flatnonzero(~crosses_goal)), *((place, crossing) for place in (0.0, *between)))
        self._places = [(place, which) for place, which in places if len(which)]
        brightness = _brightness(image)
        profiles = [_profiles(brightness, *self._lines(points, *where), self._config) for where in self._places]
        before = np.full(len(edges), np.nan) if darkest_before is None else darkest_before
        self._dark: list[Array] = []
        self._dark_drawn: list[Array | None] = []
        for (_, which), darkest in zip(self._places, map(_darkest, profiles), strict=True):
            dark, drawn = (_dark(known, self._config) for known in (darkest, np.fmax(darkest, before[which])))
            self._dark.append(dark)
            self._dark_drawn.append(drawn if (drawn > dark).any() else None)
        # A highlight on one end is not how bright the tissue is there: its neighbours have a say.
        self._levels = [_running_median(profile.level, LEVEL_WINDOW) for profile in profiles]
        self._last = np.full((3, len(edges)), np.nan)
        self._widest = self._last.copy()
        self._crossing = crossing
        self._strands_last = np.full(max(len(crossing) - 1, 0), np.nan)
        self._strands = np.zeros(len(self._strands_last), dtype=bool)
        self.look(image, points, np.ones(len(points), dtype=bool))

    def look(self, image: Image, points: Array, seen: NDArray[np.bool_], hidden: NDArray[np.bool_] | None = None) -> None:
        """Look at a new picture; edges with an end that is not `seen` (N,), or that pass what hides the tissue (H, W), are left out."""
        now, brightness = np.full_like(self._last, np.inf), _brightness(image)
        free: NDArray[np.bool_] = np.asarray(seen[self._edges].all(axis=1))
        if hidden is not None:
            free &= ~_pass_under(hidden, points[self._edges])
        kept = zip(self._places, self._dark, self._dark_drawn, self._levels, strict=True)
        for (place, which), dark, drawn, level in kept:
            profiles = _profiles(brightness, *self._lines(points, place, which), self._config)
            least = STILL_AS_BRIGHT * level * _typical(profiles.level / np.maximum(level, 1.0))
            # What has parted may be a groove, with cut faces to both sides and what is left of the tissue as its floor; the bed is seen
            # only through an opening.
            parted, bed = (_width_below(share, profiles, least) for share in (dark, self._config.bed))
            slit = parted if drawn is None else _width_below(drawn, profiles, least)
            now[:, which] = np.minimum(now[:, which], (parted, bed, slit))
            if place == 0.0 and which is self._crossing:
                self._look_between(brightness, points, profiles, least, free[which])
        now = np.where(free, now, np.nan)
        self._widest = np.fmax(self._widest, np.minimum(now, self._last))
        self._last = now

    def _look_between(
        self, brightness: NDArray[np.uint8], points: Array, profiles: _Profiles, least: Array, free: NDArray[np.bool_]
    ) -> None:
        """Look for strands between the edges across the goal. One that was seen twice in a row is there until it is missed twice."""
        level = np.where(free, np.fmax(profiles.level, least), np.nan)
        openings = _bed_place(profiles, level, self._config)
        now = strands_between(brightness, points[self._edges[self._crossing]], openings, level)
        self._strands = np.where(now == self._strands_last, now == 1.0, self._strands)
        self._strands_last = now

    def _lines(self, points: Array, place: float, which: NDArray[np.int64]) -> tuple[Array, NDArray[np.int64]]:
        """Ends (2 C, 2) and pairs (C, 2) of lines beside the edges `which` (C,), `place` of the way to the next (below 0: the last) one."""
        ends = points[self._edges[which]]
        if place and len(ends):
            beside = np.clip(np.arange(len(ends)) + (1 if place > 0 else -1), 0, len(ends) - 1)
            ends = ends + abs(place) * (ends[beside] - ends)
        return ends.reshape(-1, 2), np.arange(2 * len(ends)).reshape(-1, 2)

    def parted(self) -> Array:
        """Width (E,) [px] of the widest opening so far; nan where none could be looked for."""
        return self._widest[0].copy()

    def bed(self) -> Array:
        """Width (E,) [px] of the bed seen through the widest opening so far; nan as in `parted`."""
        return self._widest[1].copy()

    def slit(self) -> Array:
        """Width (E,) [px] of the widest opening since the goal was drawn: what was dark at t_d already counts too. nan as in `parted`."""
        return self._widest[2].copy()

    def stranded(self) -> NDArray[np.bool_]:
        """Which edges (E,) have a strand between them and the next edge across the goal, to either side."""
        beside = np.zeros(len(self._crossing), dtype=bool)
        beside[:-1] |= self._strands
        beside[1:] |= self._strands
        edges = np.zeros(len(self._edges), dtype=bool)
        edges[self._crossing] = beside
        return edges

    def decided(self) -> Array:
        """Width (E,) [px] of the openings that tell for certain: 0 where nothing opened, that of the bed where it is seen.

        nan in between, as where nobody could look: an opening that does not show the bed may be a groove.
        """
        parted, bed, _ = self._widest
        return np.where(bed > 0.0, bed, np.where(parted > 0.0, np.nan, parted))


@dataclass(frozen=True)
class _Profiles:
    """`inside` (E,) edges that lie on the image, brightness `rows` (E', T) along those, and at the darker end `level` (E,), nan outside.

    The darker end tells what tissue is there, since light falls off. `length` (E,) [px].
    """

    inside: NDArray[np.bool_]
    rows: NDArray[np.float32]
    level: Array
    length: Array


def _brightness(image: Image) -> NDArray[np.uint8]:
    """Largest channel (H, W) of `image`: cut faces are coloured, but not as bright as the outer surface in any channel."""
    red, green, blue = cv2.split(image)
    return np.asarray(cv2.GaussianBlur(cv2.max(cv2.max(red, green), blue), (3, 3), 0), dtype=np.uint8)


def _profiles(brightness: NDArray[np.uint8], points: Array, edges: NDArray[np.int64], config: GapConfig) -> _Profiles:
    height, width = brightness.shape
    a, b = points[edges[:, 0]], points[edges[:, 1]]
    with np.errstate(invalid="ignore"):
        ends = np.concatenate([a, b], axis=1)
        inside = np.asarray(((ends >= 0) & (ends <= (width - 1, height - 1, width - 1, height - 1))).all(axis=1))
    length, level = np.linalg.norm(b - a, axis=1), np.full(len(edges), np.nan)
    if not inside.any():
        return _Profiles(inside, np.zeros((0, 0), np.float32), level, length)
    count = max(config.least_samples, int(np.ceil(length[inside].max() / config.sample)))
    t = (np.arange(count) + 0.5) / count
    first, along, places = a[inside].astype(np.float32), (b - a)[inside].astype(np.float32), t.astype(np.float32)
    u, v = (first[:, k, None] + places * along[:, k, None] for k in (0, 1))
    rows = np.asarray(cv2.remap(brightness, u, v, cv2.INTER_LINEAR), dtype=np.float32)
    reach = np.minimum(config.end, config.longest_end / np.maximum(length[inside], 1e-9))
    # Sorted with what is beyond the reach behind everything else, the median of an end is its middle value.
    count_in = np.maximum(np.searchsorted(t, reach, side="right"), 1)
    level[inside] = np.minimum(_median_of_first(rows, count_in), _median_of_first(rows[:, ::-1], count_in))
    return _Profiles(inside, rows, level, length)


def _median_of_first(rows: NDArray[np.float32], count: NDArray[np.int64]) -> Array:
    """Median (E,) of the first `count` (E,) values of each row (E, T)."""
    most = int(count.max())
    masked = np.where(np.arange(most)[None] < count[:, None], rows[:, :most], np.inf)
    ordered, rank = np.sort(masked, axis=1), np.arange(len(rows))
    return np.asarray((ordered[rank, (count - 1) // 2] + ordered[rank, count // 2]) / 2.0, dtype=np.float64)


def _dark(darkest_before: Array, config: GapConfig) -> Array:
    """Share (E,) of the tissue's brightness below which a place on each edge is dark, given its darkest one before (nan: not known)."""
    known = np.nan_to_num(darkest_before, nan=0.0)
    return np.maximum(config.dark, np.minimum(config.faint, config.fainter * known))


def _width_below(share: Array | float, profiles: _Profiles, least_level: Array | None) -> Array:
    """Width (E,) [px] of the longest run along each edge that is darker than a `share`, (E,) or one for all, of the tissue's brightness.

    nan where an end is not on the image.
    """
    inside, rows = profiles.inside, profiles.rows
    level = profiles.level if least_level is None else np.fmax(profiles.level, least_level)
    width = np.full(len(inside), np.nan)
    if inside.any():
        limit = (share * np.maximum(level, 1.0))[inside, None]
        width[inside] = _longest_run(rows < limit) * (profiles.length[inside] / rows.shape[1])
    return width


def _bed_place(profiles: _Profiles, level: Array, config: GapConfig) -> Array:
    """Where (E, 2) the longest run as dark as the bed begins and ends, as shares of the edge; nan where there is none."""
    inside, rows = profiles.inside & np.isfinite(level), profiles.rows
    place = np.full((len(inside), 2), np.nan)
    if inside.any():
        dark = rows[inside[profiles.inside]] < config.bed * np.maximum(level[inside, None], 1.0)
        runs = _runs(dark)
        run, end = runs.max(axis=1), runs.argmax(axis=1) + 1
        place[inside] = np.where(run[:, None] > 0, np.column_stack([end - run, end]) / rows.shape[1], np.nan)
    return place


def _darkest(profiles: _Profiles) -> Array:
    darkest = np.full(len(profiles.inside), np.nan)
    if profiles.inside.any():
        darkest[profiles.inside] = profiles.rows.min(axis=1) / np.maximum(profiles.level[profiles.inside], 1.0)
    return darkest


def _pass_under(mask: NDArray[np.bool_], ends: Array) -> NDArray[np.bool_]:
    """Which lines (E,) between `ends` (E, 2, 2) meet the `mask` (H, W), looked at in 32 places."""
    t = np.linspace(0.0, 1.0, 32, dtype=np.float32)
    first = np.nan_to_num(ends[:, 0], nan=-1.0).astype(np.float32)
    along = np.nan_to_num(ends[:, 1], nan=-1.0).astype(np.float32) - first
    u, v = (first[:, k, None] + t * along[:, k, None] for k in (0, 1))
    # Beyond the picture nothing hides.
    return np.asarray((cv2.remap(mask.view(np.uint8), u, v, cv2.INTER_NEAREST) != 0).any(axis=1))


def _longest_run(dark: NDArray[np.bool_]) -> Array:
    """Length (E,) of the longest run of True in each row (E, T)."""
    longest = np.zeros(len(dark))
    some = dark.any(axis=1)
    if some.any():
        longest[some] = _runs(dark[some]).max(axis=1)
    return longest


def _runs(dark: NDArray[np.bool_]) -> NDArray[np.int32]:
    """Length (E, T) of the run of True that ends at each place; 0 where there is none."""
    place = np.arange(1, dark.shape[1] + 1, dtype=np.int32)
    return np.asarray(place - np.maximum.accumulate(np.where(dark, np.int32(0), place), axis=1))


def _running_median(values: Array, window: int) -> Array:
    """Median (E,) over the `window` values around each one, nan left out."""
    half = window // 2
    padded = np.pad(values, half, constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1)
    known = np.isfinite(windows).any(axis=1)
    medians = np.full(len(values), np.nan)
    medians[known] = np.nanmedian(windows[known], axis=1)
    return medians


def _typical(values: Array) -> float:
    """Their median; nan when none is known."""
    known = values[np.isfinite(values)]
    return float(median(known)) if len(known) else float("nan")
