"""The model is pulled along severed, connected, as strands and as believed; what is seen on the way changes what is believed."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hardware.interface import Array
from skills.expose.hypotheses import BELIEVED, CONNECTED, DECIDED, SEVERED, STRANDS, Hypotheses, SeparationConfig
from skills.expose.model import build_model
from skills.expose.xpbd import BLOCK, XpbdConfig, XpbdSolver
from skills.tracking.model_based import model_tracked_pixels, raycast
from tests.mocks.bench import CAMERA
from tests.mocks.exposing import ACROSS, GRASP, TISSUE, grid_on_sheet, sheet

STEP = 0.5e-3 * ACROSS
SHEET, GRID = sheet(), grid_on_sheet()
MODEL = build_model(SHEET, GRASP, TISSUE)
CROSSING = np.flatnonzero(GRID.crosses_goal)
POINTS = raycast(GRID.points, SHEET.vertices, SHEET.triangles, CAMERA)
PARTED, EXPECTED = 1.0, 4.0  # [px]
SETTINGS = {"strand": 1.5e-3, "pixel_error": 1.5, "model_error": 0.2, "quantile": 0.05, "parted": PARTED, "expected": EXPECTED}


def hypotheses(steps: int = 0, step: Array = STEP, **settings: Any) -> Hypotheses:
    """The eight versions of the sheet, pulled by `steps` times `step` [m]."""
    config = SeparationConfig(**SETTINGS | settings)
    made = Hypotheses(MODEL, SHEET, GRID, CAMERA, config, XpbdConfig(), "cpu")
    for _ in range(steps):
        made.advance(step)
    return made


def opened(h: Hypotheses, version: int) -> Array:
    """How far [px] the two lips are apart across the goal in `version`, at each seam."""
    near, far = (CAMERA.project(h.state.positions[version][MODEL.seams[:, k]]) for k in (0, 1))
    return np.asarray((near - far)[:, 0])


def elongation(h: Hypotheses, version: int) -> Array:
    """Of each edge across the goal in `version`, from the model's pixels now and at rest."""
    now, rest = (model_tracked_pixels(POINTS, x, MODEL.triangles, CAMERA) for x in (h.state.positions[version], MODEL.rest))
    one, two = GRID.edges[CROSSING].T
    return np.asarray(np.linalg.norm(now[one] - now[two], axis=1) / np.linalg.norm(rest[one] - rest[two], axis=1))


def believed(h: Hypotheses) -> Array:
    """Which seams hold in the believed version."""
    return np.asarray(h.one(BELIEVED).joined[0])


def seen(value: float, *edges: int) -> Array:
    """Openings (E,) [px]: `value` along the given edges across the goal, or along all of them; nan where nothing was looked for."""
    gaps = np.full(len(GRID.edges), np.nan)
    gaps[CROSSING[list(edges)] if edges else CROSSING] = value
    return gaps


def gaping(h: Hypotheses) -> int:
    """The edge across the goal that is expected to gape most, of those that are nearest to some seam: edges lie closer than seams."""
    nearest = np.abs(MODEL.seam_station[:, None] - GRID.station[CROSSING]).argmin(axis=1)
    return int(max(nearest, key=lambda edge: h.stretch().gap[edge]))


def seam_at(edge: int) -> int:
    """The seam next to an edge across the goal."""
    return int(np.argmin(np.abs(MODEL.seam_station - GRID.station[CROSSING[edge]])))


def test_before_any_pull_nothing_is_stretched_and_nothing_is_told_apart():
    h = hypotheses()

    expected = h.stretch()

    assert expected.severed == pytest.approx(np.ones(len(CROSSING)), abs=1e-4)
    assert expected.connected == pytest.approx(np.ones(len(CROSSING)), abs=1e-4)
    assert expected.gap == pytest.approx(np.zeros(len(CROSSING)), abs=1e-2)
    assert expected.apart == pytest.approx(np.zeros(len(CROSSING)), abs=1e-2)
    assert h.separation(expected) == pytest.approx(0.0, abs=1e-2)


def test_every_edge_across_the_goal_has_an_expectation():
    expected = hypotheses(2).stretch()

    assert np.array_equal(hypotheses().edges, CROSSING)
    for values in (expected.severed, expected.connected, expected.gap, expected.apart):
        assert values.shape == CROSSING.shape
        assert np.isfinite(values).all()


def test_a_pull_across_the_goal_opens_the_severed_version_more_and_more():
    h = hypotheses()
    widths = []
    for _ in range(6):
        h.advance(STEP)
        widths.append(opened(h, SEVERED))

    assert np.min(widths[0]) > 0.0
    assert (np.diff(widths, axis=0) > 0.0).all()


def test_a_pull_across_the_goal_does_not_open_the_connected_version():
    h = hypotheses(6)

    assert np.abs(opened(h, CONNECTED)).max() < 0.03 * opened(h, SEVERED).max()


def test_at_first_all_of_the_goal_is_believed_severed():
    h = hypotheses(4)

    assert not believed(h).any()
    assert h.state.positions[BELIEVED] == pytest.approx(h.state.positions[SEVERED], abs=1e-7)
    middle = np.interp(0.5, MODEL.seam_station, opened(h, SEVERED))
    assert np.interp(0.5, GRID.station[CROSSING], h.stretch().gap) == pytest.approx(middle, abs=1.0)


def test_lips_that_are_pushed_over_each_other_count_as_less_than_closed():
    assert np.median(hypotheses(4, -STEP).stretch().gap) < -1.0


def test_a_severed_edge_becomes_longer_than_a_connected_one():
    expected = hypotheses(6).stretch()

    assert (expected.severed > expected.connected).all()
    assert np.median(expected.severed) > 1.2 * np.median(expected.connected)


def test_severed_edges_are_as_long_as_the_severed_version_shows():
    h = hypotheses(6)

    # Both are relative to the closed length, which the grid's edges have at rest.
    assert h.stretch().severed == pytest.approx(elongation(h, SEVERED), rel=1e-4)


def test_a_strand_left_alone_stretches_more_than_the_connected_goal():
    h = hypotheses(8)

    for k, version in enumerate(range(STRANDS.start, STRANDS.stop)):
        at = np.argmin(np.abs(GRID.station[CROSSING] - (k + 0.5) / (STRANDS.stop - STRANDS.start)))
        assert elongation(h, version)[at] > elongation(h, CONNECTED)[at]
    assert (h.stretch().connected >= elongation(h, CONNECTED) - 1e-6).all()
    assert h.stretch().connected.max() > elongation(h, CONNECTED).max()


def test_the_strands_are_short_and_lie_along_the_whole_goal():
    strands = hypotheses().state.joined[STRANDS]

    centres = [np.average(MODEL.seam_station, weights=row) for row in strands]
    assert (strands.sum(axis=1) >= 1).all()
    assert (strands.mean(axis=1) < 0.5).all()
    assert (np.diff(centres) > 0.0).all()
    assert centres[0] < 0.25 < 0.75 < centres[-1]


def test_connected_tissue_pulls_hardest():
    h = hypotheses(6)

    assert h.tension.shape == h.strain.shape == (BLOCK,)
    assert h.tension.argmax() == CONNECTED
    assert h.tension.min() > 0.0 < h.strain.min()


def test_separation_grows_with_the_pull():
    h = hypotheses()
    reached = []
    for _ in range(8):
        h.advance(STEP)
        reached.append(h.separation(h.stretch()))

    assert (np.diff(reached) > 0.0).all()
    assert reached[-1] > 5 * reached[0]


def test_worse_tracking_tells_less_apart():
    good, bad = hypotheses(6, pixel_error=1.0), hypotheses(6, pixel_error=4.0)

    assert bad.separation(bad.stretch()) < 0.5 * good.separation(good.stretch())


def test_an_opening_that_is_seen_parts_the_edge_for_good():
    h = hypotheses(6)
    edge = gaping(h)
    h.see(seen(PARTED, edge))
    h.see(seen(0.0))
    h.see(seen(0.0))

    held = believed(h)
    assert held[seam_at(edge)] == 0.0
    assert held.sum() > 0.0  # its neighbours, which should gape as well, are attached


def test_an_opening_seen_late_parts_an_edge_that_seemed_attached():
    h = hypotheses(6)
    edge = gaping(h)
    h.see(seen(0.0, edge))
    assert believed(h)[seam_at(edge)] == 1.0

    h.see(seen(2 * PARTED, edge))

    assert not believed(h).any()


def test_an_edge_that_should_gape_and_does_not_is_attached_and_closes():
    h = hypotheses(6)
    edge = gaping(h)
    wide = h.stretch().gap[edge]
    h.see(seen(0.9 * PARTED, edge))

    assert believed(h).sum() == believed(h)[seam_at(edge)] == 1.0
    for _ in range(3):
        h.advance(STEP)
    assert wide > EXPECTED
    assert abs(opened(h, BELIEVED)[seam_at(edge)]) < 0.1 * wide
    assert opened(h, SEVERED)[seam_at(edge)] > wide
    assert np.delete(opened(h, BELIEVED), seam_at(edge)).max() > 0.2 * wide


def test_a_goal_that_nowhere_gapes_is_believed_connected():
    h = hypotheses()
    for _ in range(12):
        h.advance(STEP)
        h.see(seen(0.0))
    for _ in range(3):
        h.advance(STEP)

    held = believed(h)
    assert held.sum() >= len(held) - 2  # the seams at the tips may be too tight to gape
    assert np.abs(h.stretch().gap).max() < EXPECTED
    assert h.tension[BELIEVED] > h.tension[SEVERED]


def test_what_is_seen_changes_the_believed_version_alone():
    h, blind = hypotheses(6), hypotheses(6)
    h.see(seen(0.0))
    h.advance(STEP)
    blind.advance(STEP)

    others = [version for version in range(BLOCK) if version != BELIEVED]
    assert np.array_equal(h.state.joined[others], blind.state.joined[others])
    assert np.array_equal(h.state.positions[others], blind.state.positions[others])
    assert not np.array_equal(h.state.positions[BELIEVED], blind.state.positions[BELIEVED])


def test_no_opening_is_missed_before_one_is_expected():
    h = hypotheses(1)
    assert h.stretch().gap.max() < EXPECTED

    h.see(seen(0.0))

    assert not believed(h).any()
    assert h.stretch().apart.max() < DECIDED


def test_what_cannot_be_looked_at_decides_nothing():
    h, blind = hypotheses(6), hypotheses(6)

    h.see(np.full(len(GRID.edges), np.nan))

    assert not believed(h).any()
    assert np.array_equal(h.stretch().apart, blind.stretch().apart)


def test_openings_elsewhere_in_the_grid_decide_nothing():
    h = hypotheses(6)
    gaps = np.where(GRID.crosses_goal, np.nan, 20.0)

    h.see(gaps)

    assert h.stretch().apart == pytest.approx(hypotheses(6).stretch().apart)


@pytest.mark.parametrize("width", [0.0, 2 * PARTED], ids=["attached", "parted"])
def test_decided_edges_count_as_told_apart(width):
    h = hypotheses(4)
    edge = gaping(h)
    before = h.stretch().apart
    assert before[edge] < DECIDED

    h.see(seen(width, edge))

    after = h.stretch().apart
    assert after[edge] == DECIDED
    assert np.delete(after, edge) == pytest.approx(np.delete(before, edge))


def test_a_goal_seen_to_open_everywhere_is_separated_whatever_the_pull():
    h = hypotheses(1)

    h.see(seen(2 * PARTED))

    assert h.separation(h.stretch()) == DECIDED


def test_one_undecided_edge_does_not_spoil_the_separation_of_the_others():
    h = hypotheses(1, quantile=0.1)
    h.see(seen(2 * PARTED, *range(1, len(CROSSING))))

    assert h.separation(h.stretch()) > 0.5 * DECIDED


def test_one_version_can_be_planned_from():
    h = hypotheses(4)
    state = h.one(CONNECTED)

    onward = XpbdSolver(MODEL, 1, 1, XpbdConfig(), threads=1).rollout(state, STEP[None, None]).final()
    h.advance(STEP)

    assert onward.positions[0] == pytest.approx(h.state.positions[CONNECTED], abs=1e-6)


def test_the_same_pull_gives_the_same_forecast():
    one, two = hypotheses(5), hypotheses(5)
    for h in (one, two):
        h.see(seen(0.0, 3, 4))
        h.advance(STEP)

    assert np.array_equal(one.state.positions, two.state.positions)
    for name in ("severed", "connected", "gap", "apart"):
        assert np.array_equal(getattr(one.stretch(), name), getattr(two.stretch(), name))


@pytest.mark.parametrize(
    "wrong", [{"strand": 0.0}, {"pixel_error": 0.0}, {"model_error": -0.1}, {"quantile": 1.5}, {"enough": 0.0}]
)
def test_settings_without_sense_are_refused(wrong):
    with pytest.raises(ValueError, match="separation"):
        SeparationConfig(**wrong)


def test_a_strand_off_the_mesh_does_not_spoil_what_is_expected_of_its_neighbours():
    crossing = np.flatnonzero(GRID.crosses_goal)
    at = crossing[np.argmin(np.abs(GRID.station[crossing] - 0.1))]
    points = GRID.points.copy()
    points[GRID.edges[at]] = np.nan
    hypotheses = Hypotheses(MODEL, SHEET, replace(GRID, points=points), CAMERA, SeparationConfig(), XpbdConfig(), "cpu")

    hypotheses.advance(STEP)

    stretch = hypotheses.stretch()
    assert np.isnan(stretch.connected).sum() == np.isnan(stretch.severed).sum() == 1
