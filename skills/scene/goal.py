"""The dissection goal: a polyline of pixels along which tissue is to be severed, with a grasp pixel (paper, Methods)."""

from __future__ import annotations

import difflib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hardware.codes import InputError
from hardware.interface import Array
from skills.scene.polyline import arc_lengths, at_length, left_normals, resample, side_of
from skills.scene.segments import distances, touch

__all__ = ["Goal", "GoalLimits", "load_goal", "normal", "resample", "save_goal", "validate_goal"]

KEYS = ("image_size", "polyline", "grasp")


@dataclass(frozen=True)
class Goal:
    """`polyline` (M, 2) float64 pixels (u, v), M >= 2; `grasp` (2,) pixel; `image_size` (width, height)."""

    polyline: Array
    grasp: Array
    image_size: tuple[int, int]


@dataclass(frozen=True)
class GoalLimits:
    """What a goal must keep to; the paper assumes a low-curvature path, these numbers say how low."""

    min_radius: float = 40.0  # [px] about 5 mm, half a blade of the scissors
    max_turn: float = 60.0  # [degrees] at one point
    radius_reach: float = 24.0  # [px] to either side over which the radius is measured, so that a jittery hand passes
    min_grasp_distance: float = 10.0  # [px] between the grasp and the line
    min_point_distance: float = 0.5  # [px] nearer points are the same point


def load_goal(path: Path | str) -> Goal:
    """Read a goal file: JSON with `image_size` [width, height], `polyline` [[u, v], ...] and `grasp` [u, v] in pixels.

    All is checked that needs no picture; `validate_goal` with the camera's image size and a tissue mask checks the rest.

    Raises:
        InputError: the file cannot be read, is not such JSON, or holds a goal that cannot be followed; one sentence says why.
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else "it is not a text file"
        raise InputError(f"The goal file {path} cannot be read: {reason}.") from error
    try:
        data = json.loads(text)
    except (json.JSONDecodeError, RecursionError) as error:
        where = f" (line {error.lineno}: {error.msg})" if isinstance(error, json.JSONDecodeError) else ""
        raise InputError(f"The goal file {path} is not valid JSON{where}.") from error
    goal = _goal_of(data)
    validate_goal(goal)
    return goal


def save_goal(goal: Goal, path: Path | str) -> None:
    """Write `goal` as a goal file that `load_goal` reads back exactly."""
    data = {"image_size": list(goal.image_size), "polyline": goal.polyline.tolist(), "grasp": goal.grasp.tolist()}
    Path(path).write_text(json.dumps(data) + "\n", encoding="utf-8")


def normal(goal: Goal) -> Array:
    """Return the unit normal (2,) at the middle of the goal, pointing to the grasp's side: n of the paper, in pixels (u, v)."""
    middle = 101 // 2
    return side_of(goal.polyline, goal.grasp) * left_normals(resample(goal.polyline, 101))[middle]


def validate_goal(
    goal: Goal,
    image_size: tuple[int, int] | None = None,
    tissue: NDArray[np.bool_] | None = None,
    limits: GoalLimits | None = None,
) -> None:
    """Check that `goal` can be followed, also on the camera's `image_size` (width, height) and the `tissue` mask (H, W) if given.

    Raises:
        InputError: the first thing found wrong, in one sentence.
    """
    limits = limits or GoalLimits()
    _check_numbers(goal, image_size)
    _check_line(goal.polyline, limits)
    clearance = float(distances(goal.grasp[None], _pieces(goal.polyline)).min())
    if clearance < limits.min_grasp_distance:
        raise InputError(
            f"The grasp point lies {clearance:.1f} px from the goal line; at least {limits.min_grasp_distance:g} px are needed."
        )
    if tissue is not None:
        _check_tissue(goal, tissue)


def _check_numbers(goal: Goal, image_size: tuple[int, int] | None) -> None:
    """Shapes, finite numbers, image size and points inside the image."""
    if goal.polyline.ndim != 2 or goal.polyline.shape[1:] != (2,) or len(goal.polyline) < 2:
        raise InputError(f"The goal's polyline has {len(goal.polyline)} point(s); at least two points [u, v] are needed.")
    named = [(f"point {k + 1} of the goal", p) for k, p in enumerate(goal.polyline)] + [("the grasp point", goal.grasp)]
    for name, point in named:
        if not np.isfinite(point).all():
            raise InputError(f"{name[0].upper()}{name[1:]} is not a finite number: ({point[0]}, {point[1]}).")
    width, height = goal.image_size
    if image_size is not None and goal.image_size != tuple(image_size):
        raise InputError(
            f"The goal was drawn on an image of {width} x {height} pixels, "
            f"but the camera gives {image_size[0]} x {image_size[1]}."
        )
    for name, (u, v) in named:
        if not (0 <= u <= width - 1 and 0 <= v <= height - 1):
            raise InputError(f"{name[0].upper()}{name[1:]} ({u:g}, {v:g}) lies outside the image of {width} x {height} pixels.")


def _check_line(line: Array, limits: GoalLimits) -> None:
    """Distinct points, low curvature, no crossing of itself."""
    gaps = np.linalg.norm(line[:, None] - line[None], axis=-1) + np.diag(np.full(len(line), np.inf))
    i, j = np.unravel_index(int(np.argmin(gaps)), gaps.shape)
    if gaps[i, j] < limits.min_point_distance:
        raise InputError(f"Points {min(i, j) + 1} and {max(i, j) + 1} of the goal are the same; each point may occur once.")
    pieces = _pieces(line)
    meets = np.triu(touch(pieces, pieces), 2)  # neighbours always share a point
    if meets.any():
        a, b = np.argwhere(meets)[0]
        raise InputError(f"The goal crosses itself: its stretches {a + 1} and {b + 1} meet.")
    turn, at = _sharpest_turn(line)
    if turn > limits.max_turn:
        raise InputError(
            f"The goal turns by {turn:.0f} degrees at point {at + 1}; at most {limits.max_turn:g} degrees are allowed."
        )
    radius, where = _tightest_radius(line, limits.radius_reach)
    if radius < limits.min_radius:
        raise InputError(
            f"The goal curves too tightly near ({where[0]:.0f}, {where[1]:.0f}): "
            f"radius {radius:.0f} px, at least {limits.min_radius:g} px are needed."
        )


def _check_tissue(goal: Goal, tissue: NDArray[np.bool_]) -> None:
    """Every point of the line, sampled each pixel, and the grasp lie on tissue."""
    if tissue.shape != (goal.image_size[1], goal.image_size[0]):
        raise ValueError("the tissue mask and the goal must be of one image size")
    length = arc_lengths(goal.polyline)[-1]
    samples = resample(goal.polyline, int(np.ceil(length)) + 1)
    on = tissue[_nearest(samples[:, 1]), _nearest(samples[:, 0])]
    if not on.all():
        u, v = samples[int(np.argmin(on))]
        raise InputError(f"The goal leaves the tissue near ({u:.0f}, {v:.0f}).")
    u, v = goal.grasp
    if not tissue[_nearest(v), _nearest(u)]:
        raise InputError(f"The grasp point ({u:.0f}, {v:.0f}) is not on the tissue.")


def _sharpest_turn(line: Array) -> tuple[float, int]:
    """Find the largest turning angle [degrees] at one vertex, and which."""
    if len(line) < 3:
        return 0.0, 0
    a, b = np.diff(line, axis=0)[:-1], np.diff(line, axis=0)[1:]
    turns = np.abs(np.arctan2(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0], (a * b).sum(1)))
    k = int(np.argmax(turns))
    return float(np.degrees(turns[k])), k + 1


def _tightest_radius(line: Array, reach: float) -> tuple[float, Array]:
    """Find the smallest radius [px] of circles through points of the line `reach` [px] of arc apart, and where it is."""
    length = arc_lengths(line)[-1]
    step = min(reach, length / 2)
    middles = np.linspace(step, length - step, max(int(length / 2), 1))
    a, b, c = (at_length(line, middles + d) for d in (-step, 0.0, step))
    doubled_area = np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    sides = np.linalg.norm(b - a, axis=1) * np.linalg.norm(c - b, axis=1) * np.linalg.norm(c - a, axis=1)
    radii = sides / np.maximum(2 * doubled_area, 1e-12)
    k = int(np.argmin(radii))
    return float(radii[k]), b[k]


def _goal_of(data: Any) -> Goal:
    """Make a `Goal` from parsed JSON; wrong keys and shapes raise InputError."""
    if not isinstance(data, dict):
        raise InputError(f"A goal file holds one JSON object with the keys {', '.join(KEYS)}.")
    for key in data:
        if key not in KEYS:
            near = difflib.get_close_matches(key, KEYS, n=1, cutoff=0.0)[0]
            raise InputError(f"Unknown key '{key}' in the goal file; did you mean '{near}'?")
    for key in KEYS:
        if key not in data:
            raise InputError(f"The goal file lacks the key '{key}'.")
    size = data["image_size"]
    if not (isinstance(size, list) and len(size) == 2 and all(type(n) is int and n > 0 for n in size)):
        raise InputError("The goal's image_size must be two positive whole numbers, [width, height].")
    if not (_is_pixel(data["grasp"])):
        raise InputError("The goal's grasp must be one pixel, [u, v].")
    line = data["polyline"]
    if not (isinstance(line, list) and all(_is_pixel(p) for p in line)):
        raise InputError("The goal's polyline must be a list of pixels, [[u, v], ...].")
    return Goal(
        np.array(line, dtype=np.float64).reshape(-1, 2), np.array(data["grasp"], dtype=np.float64), (int(size[0]), int(size[1]))
    )


def _is_pixel(value: Any) -> bool:
    return isinstance(value, list) and len(value) == 2 and all(type(n) in (int, float) for n in value)


def _pieces(line: Array) -> Array:
    """Give the (M - 1, 2, 2) segments of a polyline (M, 2)."""
    return np.stack([line[:-1], line[1:]], axis=1)


def _nearest(x: Any) -> Any:
    return np.rint(x).astype(np.int64)
