"""The likelihood of each edge: what opened, how long it became against what was expected, and whether the two agree."""

from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hardware.codes import Code
from hardware.interface import Array
from skills.estimate import elongation
from skills.estimate.graph import ConnectivityGraph, EdgeState
from skills.estimate.grid import Grid, GridConfig, grid_around, lengths
from skills.estimate.likelihood import Evidence, LikelihoodConfig, Weights, estimate_connectivity, evidence, log_odds
from skills.estimate.look import Look
from skills.estimate.stretches import attachments
from skills.expose.outcome import Forecast
from skills.tracking.tracks import Tracks
from tests.skills.goals import straight, tracked_goal

GRID = grid_around(tracked_goal(straight()), 8.0, GridConfig(station_spacing=16.0))
CROSSING = np.flatnonzero(GRID.crosses_goal)
ELSEWHERE = np.flatnonzero(~GRID.crosses_goal)
COUNT, CLOSED = len(CROSSING), GRID.closed_length
STEPS = 6
WIDE = 12.0  # [px]
NAN = float("nan")
Numbers = Array | float


def ramp(end: Numbers, steps: int = STEPS, start: float = 1.0) -> Array:
    """From `start` at t_d to `end` after the last step: (steps, C)."""
    share = np.arange(1, steps + 1)[:, None] / steps
    return np.asarray(start + share * (np.broadcast_to(np.asarray(end, dtype=float), (COUNT,)) - start))


def forecast(severed: Numbers, connected: Numbers, steps: int = STEPS) -> Forecast:
    """Elongations that were expected in the end, reached evenly."""
    gap = CLOSED * (ramp(severed, steps) - 1.0)
    return Forecast(CROSSING, ramp(severed, steps), ramp(connected, steps), gap, np.full(steps, 3.0))


EXPECTED = forecast(3.0, 1.4)


def keypoints(rho: Numbers, grid: Grid = GRID) -> Array:
    """The grid's points with the edges across the goal `rho` times as long as while it was closed, one number for each station."""
    opened = np.broadcast_to((np.asarray(rho, dtype=float) - 1.0) * CLOSED, (COUNT,))
    columns = np.tile(opened, len(grid.points) // COUNT)
    points = grid.points.copy()
    points[:, 1] += np.where(grid.near_side, -columns / 2, columns / 2)
    return points


def tracks(points: Array, hidden: Array | None = None) -> Tracks:
    visible = np.ones(len(points), dtype=bool)
    if hidden is not None:
        visible[hidden] = False
    return Tracks(1.0, points, visible, visible.astype(float))


def openings(across: Numbers) -> Array:
    """(E,) [px] along the edges across the goal, none along the others."""
    widths = np.zeros(len(GRID.edges))
    widths[CROSSING] = across
    return widths


def seen_at(step: int, found: Tracks, parted: Array, bed: Array) -> Look:
    """A look at which what is not seen has no place either."""
    return Look(step, found, found.visible, parted, bed, parted, np.zeros(len(parted), dtype=bool))


def unopened(step: int, rho: Numbers) -> Look:
    """A look at edges that are `rho` times as long and opened nothing."""
    return seen_at(step, tracks(keypoints(rho)), openings(0.0), openings(0.0))


def pulled(rho: Numbers, parted: Numbers = 0.0, bed: Numbers = 0.0, hidden: Array | None = None) -> list[Look]:
    """A look after each step of a pull at whose end the edges across the goal are `rho` times as long; openings grow as well.

    Keypoints that are `hidden` (indices) are so from halfway on.
    """
    looks = []
    for step, along in enumerate(ramp(rho), start=1):
        share, out = step / STEPS, hidden if step > STEPS / 2 else None
        looks.append(seen_at(step, tracks(keypoints(along), out), openings(share * parted), openings(share * bed)))
    return looks


def judge(looks: list[Look], expected: Forecast | None = EXPECTED, **settings: Any) -> ConnectivityGraph:
    return estimate_connectivity(GRID, GRID.points, looks, expected, LikelihoodConfig(**settings))


def states(graph: ConnectivityGraph) -> set[EdgeState]:
    """What the edges across the goal were called."""
    return {EdgeState(state) for state in graph.state[CROSSING]}


def ends_of(*edges: int) -> Array:
    """One end of each of these edges across the goal."""
    return GRID.edges[CROSSING[list(edges)], 0]


# ------------------------------------------------------------ what opened


def test_a_goal_that_opened_to_the_bed_and_became_as_long_as_expected_is_severed():
    graph = judge(pulled(3.0, WIDE, WIDE))

    assert states(graph) == {EdgeState.SEVERED}
    assert graph.complete and graph.code is Code.OK
    assert graph.message == f"All {COUNT} edges across the goal are severed."
    assert graph.probability[CROSSING].min() > 0.99


def test_a_goal_that_opened_nothing_and_kept_its_length_is_connected():
    graph = judge(pulled(1.2))

    assert states(graph) == {EdgeState.CONNECTED}
    assert graph.uncut.sum() == COUNT and not graph.complete
    assert len(attachments(graph)) == 1


@pytest.mark.parametrize("expected", [EXPECTED, None], ids=["forecast", "no forecast"])
def test_the_bed_seen_through_an_opening_makes_an_edge_severed(expected):
    assert states(judge(pulled(2.2, WIDE, WIDE), expected)) == {EdgeState.SEVERED}


def test_bed_that_was_seen_makes_an_edge_severed_though_its_length_seems_to_say_otherwise():
    assert states(judge(pulled(1.2, WIDE, WIDE))) == {EdgeState.SEVERED}


def test_a_little_of_the_bed_does_not_outweigh_a_length_as_of_a_connected_edge():
    assert EdgeState.SEVERED not in states(judge(pulled(1.2, 1.0, 0.5)))


@pytest.mark.parametrize("rho", [1.0, 1.4, 1.8])
def test_a_wide_groove_without_bed_makes_none_severed_by_itself(rho):
    assert EdgeState.SEVERED not in states(judge(pulled(rho, parted=40.0)))


def test_what_shows_the_bed_is_more_likely_severed_than_a_groove():
    for rho in (1.4, 2.2, 3.0):
        groove, through = (judge(pulled(rho, WIDE, bed)).probability[CROSSING] for bed in (0.0, WIDE))

        assert (groove < through).all()


def test_a_groove_is_more_likely_severed_than_tissue_that_opened_nothing_while_no_bed_is_due():
    early = forecast(1.2, 1.1)  # an opening of 3 px at most: the light does not reach the bed
    whole, groove = (judge(pulled(1.2, parted), early).probability[CROSSING] for parted in (0.0, WIDE))

    assert (whole < groove).all()


def test_a_groove_that_should_have_opened_to_the_bed_by_now_is_less_likely_severed_than_one_that_need_not():
    due, early = (replace(EXPECTED, gap=np.full((STEPS, COUNT), gap)) for gap in (20.0, 1.0))
    looks = pulled(2.2, WIDE)

    assert (judge(looks, due).probability[CROSSING] < judge(looks, early).probability[CROSSING]).all()


@pytest.mark.parametrize("gap", [1.0, 20.0])
def test_an_opening_that_shows_the_bed_is_a_cut_whatever_width_was_expected_of_it(gap):
    expected = replace(EXPECTED, gap=np.full((STEPS, COUNT), gap))

    assert judge(pulled(2.6, WIDE, WIDE), expected).complete


def test_an_opening_of_a_fraction_of_a_pixel_says_next_to_nothing():
    noise, none = (judge(pulled(1.4, width, width)).probability[CROSSING] for width in (0.1, 0.0))

    assert noise == pytest.approx(none, abs=0.05)


def opening_of(width: float, due: float, hidden: Array | None = None, bed: float = 0.0) -> ConnectivityGraph:
    """A goal that opened `width` where `due` pixels were expected of a cut, its lengths telling nothing."""
    nothing = replace(forecast(1.5, 1.5), gap=np.full((STEPS, COUNT), due))
    return judge(pulled(1.5, width, bed, hidden), nothing)


def test_what_opened_much_wider_than_a_cut_would_is_severed_though_no_bed_is_seen_yet():
    assert opening_of(6.0, 2.0).complete


@pytest.mark.parametrize("due", [5.0, 8.0, 30.0])
def test_what_opened_no_wider_than_a_cut_would_may_be_a_groove(due):
    assert EdgeState.SEVERED not in states(opening_of(5.0, due))


def test_what_opened_far_less_than_a_cut_would_says_no_more_than_tissue_that_opened_nothing():
    little, none = (opening_of(width, 30.0).probability[CROSSING] for width in (4.0, 0.0))

    assert little == pytest.approx(none)


def test_openings_narrower_than_can_be_compared_are_no_wider_than_expected():
    assert EdgeState.SEVERED not in states(opening_of(1.0, 0.01))


def test_where_nothing_was_expected_of_an_opening_it_is_neither_wider_nor_narrower():
    unknown = replace(EXPECTED, gap=np.full((STEPS, COUNT), NAN))

    assert not evidence(GRID, GRID.points, pulled(2.0, WIDE), unknown).excess.any()
    assert not evidence(GRID, GRID.points, pulled(2.0, WIDE), None).excess.any()


def excess_at(middle: int, widths: list[float], due: float = 3.0) -> float:
    """That of one edge where it and its neighbours opened to `widths`, and nothing else did."""
    opened = np.zeros(COUNT)
    opened[middle - 1 : middle + 2] = widths
    expected = replace(EXPECTED, gap=np.full((STEPS, COUNT), due))
    return float(evidence(GRID, GRID.points, pulled(2.0, opened), expected).excess[CROSSING[middle]])


def test_what_lies_beside_a_strand_is_unknown_however_wide_it_opened():
    looks = pulled(3.0, parted=30.0, bed=30.0)
    beside = np.zeros(len(GRID.edges), dtype=bool)
    beside[CROSSING[3:5]] = True
    looks[-1] = replace(looks[-1], stranded=beside)

    state = judge(looks).state[CROSSING]

    assert (state[3:5] == EdgeState.UNKNOWN).all()
    assert (np.delete(state, [3, 4]) == EdgeState.SEVERED).all()


def test_an_opening_alone_is_compared_with_what_was_expected_of_its_own_edge():
    assert excess_at(COUNT // 2, [0.0, 6.0, 0.0]) == pytest.approx(np.log(2.0))
    assert excess_at(1, [0.0, 2.0, 0.0]) == pytest.approx(np.log(2.0 / 3.0))


def test_an_opening_beside_a_wide_one_is_no_wider_for_it_but_beside_narrow_ones_it_is_doubted():
    alone, beside_gaping, beside_narrow = (excess_at(COUNT // 2, [side, 6.0, side]) for side in (0.0, 30.0, 2.0))

    assert beside_gaping == alone
    assert beside_narrow == pytest.approx(np.log(10.0 / 9.0))


def test_what_opened_nothing_and_what_is_no_edge_across_the_goal_opened_no_wider_than_expected():
    found = evidence(GRID, GRID.points, pulled(2.0, np.where(np.arange(COUNT) == 3, WIDE, 0.0)), EXPECTED)

    assert np.flatnonzero(found.excess).tolist() == [CROSSING[3]]


def test_a_later_look_says_more_than_an_early_one():
    # Both hypotheses lie as far apart in every look.
    apart = Forecast(CROSSING, *(np.full((STEPS, COUNT), x) for x in (3.0, 1.4, 28.0)), np.full(STEPS, 3.0))
    severed, connected = unopened(1, 3.0), unopened(1, 1.4)
    falling, rising = (
        [replace(look, step=k) for k, look in enumerate(looks, 1)]
        for looks in ([severed] * 3 + [connected] * 3, [connected] * 3 + [severed] * 3)
    )

    fell, rose = (evidence(GRID, GRID.points, looks, apart).length[CROSSING] for looks in (falling, rising))

    assert (rose > 0).all() and (fell < 0).all()
    assert rose == pytest.approx(-fell, rel=0.05)


def test_an_opening_that_could_not_be_looked_for_is_none():
    blind = [replace(look, parted=openings(NAN), bed=openings(NAN)) for look in pulled(2.4)]

    assert np.array_equal(judge(blind).probability, judge(pulled(2.4)).probability)


# ------------------------------------------------------------ how long it became


def test_a_stretched_attachment_is_not_severed_where_the_papers_rule_calls_it_so():
    looks = pulled(2.5)

    by_threshold = elongation.estimate_connectivity(GRID, GRID.points, looks[-1].tracks)
    graph = judge(looks, forecast(4.5, 2.5))

    assert by_threshold.complete
    assert EdgeState.SEVERED not in states(graph)
    assert not graph.complete


def test_an_attachment_that_stretches_as_far_as_a_soft_one_should_is_connected():
    graph = judge(pulled(2.5), forecast(12.0, 2.5))

    assert states(graph) == {EdgeState.CONNECTED}


def test_a_severed_edge_that_opened_little_is_severed_where_the_papers_rule_calls_it_connected():
    looks = pulled(1.6, 4.0, 4.0)

    by_threshold = elongation.estimate_connectivity(GRID, GRID.points, looks[-1].tracks)

    assert by_threshold.uncut.sum() == COUNT
    assert judge(looks, forecast(1.6, 1.1)).complete


def test_a_length_as_expected_of_a_severed_edge_raises_and_of_a_connected_one_lowers_the_probability():
    for widths in ((0.0, 0.0), (WIDE, 0.0), (WIDE, 1.0)):
        severed, connected = (judge(pulled(rho, *widths)).probability[CROSSING] for rho in (3.0, 1.4))
        telling_nothing = judge(pulled(2.0, *widths), forecast(2.0, 2.0)).probability[CROSSING]

        assert (severed > telling_nothing).all() and (telling_nothing > connected).all()


@pytest.mark.parametrize("rho", [3.0, 4.0, 8.0, 20.0])
def test_what_became_long_without_any_opening_has_been_mistracked_and_is_unknown_at_most(rho):
    assert EdgeState.SEVERED not in states(judge(pulled(rho)))


def test_the_same_length_says_more_where_an_opening_is_seen():
    def gained(parted: float) -> Array:
        """How much a length as of a severed edge adds to the log odds."""
        odds = [np.log(p / (1 - p)) for p in (judge(pulled(r, parted)).probability[CROSSING] for r in (2.2, 3.0))]
        return np.asarray(odds[1] - odds[0])

    assert (gained(WIDE) > 1.5 * gained(0.0)).all()


def test_a_length_that_was_expected_of_both_tells_nothing():
    short, long = (judge(pulled(rho, WIDE), forecast(2.0, 2.0)).probability for rho in (1.5, 2.5))

    assert long == pytest.approx(short)


def test_the_whole_history_counts_and_not_the_last_look_alone():
    as_connected, as_severed = pulled(1.4), pulled(3.0)
    late = [*as_connected[:-1], as_severed[-1]]

    always, once, never = (judge(looks).probability[CROSSING] for looks in (as_severed, late, as_connected))

    assert (always > once).all() and (once > never).all()
    assert EdgeState.SEVERED not in states(judge(late))


def test_each_look_is_held_against_what_was_expected_after_its_own_step():
    # At halfway this length is that of a severed edge, in the end that of a connected one.
    early, late = unopened(3, 2.0), unopened(6, 2.0)
    expected = forecast(3.0, 2.0)

    first, last = (evidence(GRID, GRID.points, [look], expected).length[CROSSING] for look in (early, late))

    assert (first > 0.5).all() and (last < -0.3).all()


def test_a_look_after_more_steps_than_the_forecast_has_is_held_against_its_last_one():
    late, last = (judge([unopened(step, 2.6)]) for step in (STEPS + 4, STEPS))

    assert np.array_equal(late.probability, last.probability)


def test_before_the_first_step_no_length_says_anything():
    found = evidence(GRID, GRID.points, [unopened(0, 1.0)], EXPECTED)

    assert np.isnan(found.length).all()


def test_a_cut_already_open_at_the_reference_counts_from_the_closed_cut():
    reference = keypoints(1.0 + 20.0 / CLOSED)
    looks = pulled(3.0, WIDE, WIDE)

    opened = estimate_connectivity(GRID, reference, looks, EXPECTED)

    assert opened.elongation[CROSSING] == pytest.approx(3.0)
    assert opened.probability[CROSSING] == pytest.approx(judge(looks).probability[CROSSING])


def test_however_wrong_the_model_is_what_was_seen_of_the_bed_outweighs_the_lengths():
    seen, unseen = judge(pulled(1.0, WIDE, WIDE), forecast(30.0, 1.0)), judge(pulled(1.0), forecast(30.0, 1.0))

    assert seen.probability[CROSSING].min() > 0.5
    assert EdgeState.CONNECTED not in states(seen)
    assert states(unseen) == {EdgeState.CONNECTED}


# ------------------------------------------------------------ nothing expected


@pytest.mark.parametrize(
    "missing",
    [
        None,
        Forecast(CROSSING, *(np.zeros((0, COUNT)),) * 3, np.zeros(0)),
        Forecast(CROSSING, *(np.full((STEPS, COUNT), NAN),) * 3, np.zeros(STEPS)),
    ],
    ids=["none", "no steps", "off the mesh"],
)
def test_where_nothing_was_expected_openings_and_elongation_decide(missing):
    rho = np.linspace(1.8, 3.0, COUNT)
    opened, whole = judge(pulled(rho, WIDE, WIDE), missing), judge(pulled(rho), missing)

    for judged in (opened, whole):
        probability = judged.probability[CROSSING]
        assert np.isfinite(judged.probability).all()
        assert (np.diff(probability) >= 0).all() and probability[-1] > probability[0]
    assert opened.complete
    assert not (whole.state == EdgeState.SEVERED).any()


def test_an_edge_of_which_nothing_was_expected_is_judged_like_one_without_a_forecast():
    part = forecast(3.0, 1.4)
    part.severed[:, 4] = part.connected[:, 4] = part.gap[:, 4] = NAN
    looks = pulled(2.0, 1.0)

    mixed, without = judge(looks, part).probability[CROSSING], judge(looks, None).probability[CROSSING]

    assert mixed[4] == without[4]
    assert (np.delete(mixed, 4) != np.delete(without, 4)).all()


# ------------------------------------------------------------ what is not seen


def test_edges_across_the_goal_with_a_hidden_end_are_unknown_and_never_severed():
    hidden = ends_of(3)
    graph = judge(pulled(3.0, WIDE, 0.0, hidden))

    touched = np.isin(GRID.edges, hidden).any(axis=1) & GRID.crosses_goal
    assert (graph.state[touched] == EdgeState.UNKNOWN).all()
    assert np.isfinite(graph.probability[touched]).all()
    assert np.isnan(graph.elongation[touched]).all()
    assert not graph.complete


def test_an_edge_beside_the_goal_that_something_hides_later_stays_connected_but_not_one_that_was_never_seen():
    hidden = ends_of(3)
    beside = np.isin(GRID.edges, hidden).any(axis=1) & ~GRID.crosses_goal
    later = pulled(1.4, hidden=hidden)
    never = [replace(look, tracks=tracks(look.tracks.points, hidden)) for look in later]
    for looks in (later, never):
        for k, look in enumerate(looks):
            looks[k] = replace(look, placed=look.tracks.visible)

    assert (judge(later).state[beside] == EdgeState.CONNECTED).all()
    assert (judge(never).state[beside] == EdgeState.UNKNOWN).all()


def test_an_edge_hidden_later_stays_severed_where_the_bed_was_seen_before():
    graph = judge(pulled(3.0, WIDE, WIDE, ends_of(3)))

    assert states(graph) == {EdgeState.SEVERED}
    assert np.isnan(graph.elongation[CROSSING[3]])
    assert graph.complete


def test_an_edge_hidden_later_stays_severed_where_it_had_opened_wider_than_any_groove_would():
    graph = opening_of(8.0, 2.0, ends_of(3))

    assert np.isnan(graph.elongation[CROSSING[3]])
    assert graph.complete


@pytest.mark.parametrize("bed", [0.0, 1.5])
def test_neither_a_length_nor_a_sliver_of_bed_severs_an_edge_that_is_hidden_now(bed):
    seen, hidden = (
        judge(pulled(3.0, WIDE, bed, ends), replace(EXPECTED, gap=np.full((STEPS, COUNT), WIDE))) for ends in (None, ends_of(3))
    )

    assert hidden.probability[CROSSING[3]] > LikelihoodConfig().severed
    assert seen.state[CROSSING[3]] == EdgeState.SEVERED
    assert hidden.state[CROSSING[3]] == EdgeState.UNKNOWN


def test_a_sliver_of_bed_is_not_enough_for_an_edge_that_is_hidden_now():
    graph = judge(pulled(3.0, WIDE, 1.5, ends_of(3)))

    assert graph.state[CROSSING[3]] == EdgeState.UNKNOWN


def test_doubtful_and_non_finite_tracks_are_unknown():
    looks = pulled(3.0, WIDE, WIDE)
    a, b = GRID.edges[CROSSING[0], 0], GRID.edges[CROSSING[1], 1]
    for look in looks[len(looks) // 2 :]:
        look.tracks.confidence[a] = 0.05
        look.tracks.points[b] = NAN
    looks = [replace(look, bed=openings(0.0)) for look in looks]

    graph = judge(looks)

    assert (graph.state[CROSSING[:2]] == EdgeState.UNKNOWN).all()
    assert np.isfinite(graph.probability).all()


def test_what_hides_an_end_at_the_last_moment_takes_nothing_back_of_what_was_seen_before():
    looks = pulled(1.1)
    before = judge(looks)
    looks[-1] = replace(looks[-1], tracks=tracks(looks[-1].tracks.points, ends_of(3)))

    after = judge(looks)

    assert states(before) == states(after) == {EdgeState.CONNECTED}


def test_looks_in_which_an_end_was_hidden_say_nothing_of_its_edge():
    hidden = [replace(look, tracks=tracks(look.tracks.points, ends_of(2))) for look in pulled(1.4)[:3]]
    rest = pulled(3.0, WIDE, WIDE)[3:]

    some = evidence(GRID, GRID.points, [*hidden, *rest], EXPECTED).length[CROSSING]
    without = evidence(GRID, GRID.points, rest, EXPECTED).length[CROSSING]

    assert some[2] == without[2]
    assert (np.delete(some, 2) < np.delete(without, 2)).all()


def test_too_many_unknown_edges_say_so():
    most = int(0.5 * COUNT)
    few, many = (judge(pulled(3.0, WIDE, 0.0, ends_of(*range(n)))) for n in (most, most + 1))

    assert few.code is Code.OK and not few.complete
    assert many.code is Code.TOO_MANY_UNKNOWN
    assert not many.complete
    assert f"{most + 1} of {COUNT} edges" in many.message


@given(st.integers(0, COUNT - 1), st.sampled_from(["hidden", "lost", "doubtful"]))
def test_with_an_unknown_edge_across_it_the_goal_is_never_complete(which, how):
    looks = pulled(3.0, WIDE, WIDE)
    looks[-1] = replace(looks[-1], bed=openings(np.where(np.arange(COUNT) == which, 0.0, WIDE)))
    end = GRID.edges[CROSSING[which], 0]
    for late in (look.tracks for look in looks[len(looks) // 2 :]):
        if how == "hidden":
            late.visible[end] = False
        elif how == "lost":
            late.points[end] = NAN
        else:
            late.confidence[end] = 0.1

    graph = judge(looks)

    assert graph.state[CROSSING[which]] == EdgeState.UNKNOWN
    assert (np.delete(graph.state[CROSSING], which) == EdgeState.SEVERED).all()
    assert not graph.complete
    assert graph.uncut.sum() == 1


# ------------------------------------------------------------ what is no cut


def test_a_rigid_motion_of_the_view_severs_nothing():
    angle, middle = np.deg2rad(35.0), np.array([320.0, 240.0])
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    looks = [
        seen_at(step, tracks((GRID.points - middle) @ turn + middle + 3.0 * step), openings(0.0), openings(0.0))
        for step in (1, 2, 3)
    ]

    graph = judge(looks, forecast(3.0, 1.1))

    assert graph.elongation == pytest.approx(1.0)
    assert (graph.state == EdgeState.CONNECTED).all()


@pytest.mark.parametrize("across", [0.0, 0.3], ids=["along", "along and across"])
def test_a_curved_goal_that_straightens_severs_nothing(across):
    t = np.linspace(0.0, 1.0, 41)
    bent = np.column_stack([480.0 - 320.0 * t, 240.0 - 60.0 * np.sin(np.pi * t)])
    grid = grid_around(tracked_goal(bent), 8.0, GridConfig(station_spacing=16.0))
    points = grid.points.copy()
    bow = 60.0 * np.sin(np.pi * (480.0 - np.clip(points[:, 0], 160.0, 480.0)) / 320.0)
    points[:, 1] = 240.0 + (1.0 + across) * (points[:, 1] + bow - 240.0)
    crossing = np.flatnonzero(grid.crosses_goal)
    rho = lengths(points, grid.edges[crossing]) / lengths(grid.points, grid.edges[crossing])
    expected = Forecast(crossing, rho[None] + 1.5, rho[None], rho[None] - 1.0, np.ones(1))
    none = np.zeros(len(grid.edges))

    graph = estimate_connectivity(grid, grid.points, [seen_at(1, tracks(points), none, none)], expected)

    assert not (graph.state == EdgeState.SEVERED).any()
    assert (graph.state[crossing] == EdgeState.CONNECTED).mean() > 0.9


def test_uneven_stretch_that_was_expected_severs_nothing_where_the_papers_rule_finds_gaps():
    uneven = 1.1 + 1.7 * np.sin(np.linspace(0.0, np.pi, COUNT))
    looks = pulled(uneven)

    by_threshold = elongation.estimate_connectivity(GRID, GRID.points, looks[-1].tracks)
    graph = judge(looks, forecast(2.5 * uneven, uneven))

    assert (by_threshold.state[CROSSING] == EdgeState.SEVERED).sum() > 3
    assert not (graph.state == EdgeState.SEVERED).any()


def test_a_grasp_that_slipped_leaves_a_severed_goal_undecided_and_not_connected():
    # The lips came apart at first and fell back, while the model went on pulling.
    slipped = [
        replace(look, step=step) for step, look in enumerate([*pulled(3.0, WIDE, WIDE)[:3], *pulled(1.3, WIDE, WIDE)[3:]], 1)
    ]

    assert EdgeState.CONNECTED not in states(judge(slipped))


def test_an_attachment_between_severed_edges_is_found_where_it_is():
    strand = np.zeros(COUNT, dtype=bool)
    strand[7:10] = True
    width = np.where(strand, 0.0, WIDE)

    graph = judge(pulled(np.where(strand, 1.4, 3.0), width, width))

    assert np.array_equal(graph.state[CROSSING] == EdgeState.CONNECTED, strand)
    assert np.array_equal(graph.uncut[CROSSING], strand)
    ((start, end),) = attachments(graph)
    assert start < GRID.station[CROSSING[7:10]].min() and end > GRID.station[CROSSING[7:10]].max()


def test_edges_away_from_the_goal_need_far_more_evidence():
    everywhere = np.full(len(GRID.edges), WIDE)
    groove = [replace(look, parted=everywhere, bed=0.0 * everywhere) for look in pulled(2.5)]
    through = [replace(look, parted=everywhere, bed=everywhere) for look in pulled(2.5)]

    for looks in (groove, through):
        graph = judge(looks, None)
        assert graph.probability[ELSEWHERE].max() < graph.probability[CROSSING].min()
        assert not (graph.state[ELSEWHERE] == EdgeState.SEVERED).any()
    assert (judge(groove, None).state[ELSEWHERE] == EdgeState.CONNECTED).all()


def test_an_edge_away_from_the_goal_that_gapes_to_the_bed_and_became_very_long_is_rather_severed():
    parted = int(ELSEWHERE[np.argmax(np.isin(GRID.edges[ELSEWHERE], np.flatnonzero(GRID.near_side)).all(axis=1))])
    gap = openings(0.0)
    gap[parted] = 60.0
    points = keypoints(1.0)
    a, b = GRID.edges[parted]
    points[b] = points[a] + 12.0 * (points[b] - points[a])

    graph = judge([seen_at(STEPS, tracks(points), gap, gap)], None)

    assert graph.probability[parted] > 0.8
    assert graph.state[parted] != EdgeState.CONNECTED
    assert (np.delete(graph.state, parted)[np.delete(~GRID.crosses_goal, parted)] == EdgeState.CONNECTED).mean() > 0.9


# ------------------------------------------------------------ as a function


def one(parted: float, bed: float, length: float, excess: float = 0.0, slit: float = 0.0, slit_excess: float = 0.0) -> float:
    """Log odds of one edge across the goal."""
    openings = {"parted": parted, "bed": bed, "excess": excess, "slit": slit, "slit_excess": slit_excess}
    values = {**openings, "length": length, "ratio": 1.5}
    found = Evidence(**{name: np.array([value]) for name, value in values.items()}, seen=np.array([True]))
    return float(log_odds(found, np.array([True]))[0])


WIDTH, NATS, LONG, EXCESS = st.floats(0.0, 30.0), st.floats(-6.0, 6.0), st.floats(0.5, 8.0), st.floats(-1.0, 1.0)


@given(WIDTH, WIDTH, WIDTH, EXCESS, NATS)
def test_more_bed_is_never_less_likely_a_cut(a, b, parted, excess, length):
    low, high = sorted((a, b))

    assert one(parted, low, length, excess) <= one(parted, high, length, excess) + 1e-9


@given(WIDTH, WIDTH, EXCESS, NATS, st.sampled_from([0.0, 30.0]))
def test_a_wider_opening_is_never_less_likely_a_cut(a, b, excess, length, bed):
    low, high = sorted((a, b))

    assert one(low, bed, length, excess) <= one(high, bed, length, excess) + 1e-9


@given(WIDTH, WIDTH, WIDTH, EXCESS, EXCESS, NATS, st.sampled_from([0.0, 30.0]))
def test_a_wider_slit_that_was_there_at_first_is_never_less_likely_a_cut(a, b, parted, excess, slit_excess, length, bed):
    low, high = (one(parted, bed, length, excess, slit, slit_excess) for slit in sorted((a, b)))

    assert low <= high + 1e-9


@given(WIDTH, EXCESS, NATS)
def test_a_slit_that_was_there_at_first_says_no_more_than_one_that_opened_as_expected(slit, slit_excess, length):
    assert one(0.0, 0.0, length, 0.0, slit, slit_excess) <= one(slit, 0.0, length) + 1e-9


def test_a_slit_that_was_there_at_first_is_severed_only_if_its_length_says_so_too():
    severed = np.log(LikelihoodConfig().severed / (1.0 - LikelihoodConfig().severed))

    assert one(0.0, 0.0, 0.0, slit=30.0, slit_excess=1.0) < severed
    assert one(0.0, 0.0, 2.0, slit=30.0) > severed
    assert one(0.0, 0.0, 2.0, slit=30.0, slit_excess=-1.0) < severed  # a cut would have opened more


@given(EXCESS, EXCESS, WIDTH, WIDTH, NATS)
def test_what_opened_wider_than_a_cut_would_is_never_less_likely_one(a, b, parted, bed, length):
    low, high = sorted((a, b))

    assert one(parted, bed, length, low) <= one(parted, bed, length, high) + 1e-9


@given(NATS, NATS, WIDTH, WIDTH, EXCESS)
def test_a_length_that_speaks_more_for_a_cut_is_never_less_likely_one(a, b, parted, bed, excess):
    low, high = sorted((a, b))

    assert one(parted, bed, low, excess) <= one(parted, bed, high, excess) + 1e-9


@given(LONG, LONG, st.sampled_from([0.0, 1.2, WIDE]), st.booleans())
def test_a_longer_edge_is_never_less_likely_severed(a, b, width, foreseen):
    expected = EXPECTED if foreseen else None
    short, long = (judge(pulled(rho, width), expected) for rho in sorted((a, b)))

    assert (short.probability[CROSSING] <= long.probability[CROSSING] + 1e-9).all()


@given(st.integers(0, 10**6))
def test_the_state_follows_from_the_probability_of_what_is_seen(seed):
    rng = np.random.default_rng(seed)
    hidden = rng.choice(len(GRID.points), rng.integers(0, 20), replace=False)
    graph = judge(pulled(rng.uniform(0.8, 6.0, COUNT), *rng.uniform(0.0, 4.0, (2, COUNT)), hidden))

    config = LikelihoodConfig()
    assert ((graph.probability >= 0) & (graph.probability <= 1)).all()
    assert (graph.probability[graph.state == EdgeState.SEVERED] >= config.severed).all()
    assert (graph.probability[graph.state == EdgeState.CONNECTED] <= config.connected).all()
    seen = ~np.isin(GRID.edges, hidden).any(axis=1)
    between = graph.probability[seen & (graph.state == EdgeState.UNKNOWN)]
    assert ((between > config.connected) & (between < config.severed)).all()


@given(st.integers(0, 10**6))
def test_the_order_of_edges_does_not_matter(seed):
    rng = np.random.default_rng(seed)
    order = rng.permutation(len(GRID.edges))
    shuffled = replace(GRID, edges=GRID.edges[order], crosses_goal=GRID.crosses_goal[order], station=GRID.station[order])
    looks = pulled(np.linspace(1.0, 4.0, COUNT), *np.linspace(6.0, 0.0, 2 * COUNT).reshape(2, COUNT))
    moved = [replace(look, parted=look.parted[order], bed=look.bed[order], slit=look.slit[order]) for look in looks]
    # The forecast names the same edges by their new places, in an order of its own.
    where, own = np.argsort(order)[CROSSING], rng.permutation(COUNT)
    told = forecast(np.linspace(2.0, 5.0, COUNT), 1.3)
    other = Forecast(where[own], told.severed[:, own], told.connected[:, own], told.gap[:, own], told.separation)

    plain, mixed = judge(looks, told), estimate_connectivity(shuffled, GRID.points, moved, other)

    assert mixed.probability == pytest.approx(plain.probability[order], abs=1e-12)
    assert np.array_equal(mixed.state, plain.state[order])
    assert attachments(mixed) == attachments(plain)


def test_the_graph_says_where_the_keypoints_were_and_are_and_nothing_given_is_changed():
    looks, reference = pulled(3.0, WIDE, WIDE), GRID.points.copy()

    graph = estimate_connectivity(GRID, reference, looks, EXPECTED)
    graph.reference[:], graph.points[:] = 0.0, 0.0

    assert np.array_equal(reference, GRID.points)
    assert np.array_equal(looks[-1].tracks.points, keypoints(3.0))
    assert np.array_equal(graph.edges, GRID.edges) and np.array_equal(graph.station, GRID.station, equal_nan=True)


# ------------------------------------------------------------ settings


@pytest.mark.parametrize(
    "wrong",
    [
        {"severed": 0.5},
        {"severed": 0.4},
        {"severed": 1.2},
        {"severed": NAN},
        {"connected": 0.5},
        {"connected": 0.9},
        {"connected": -0.1},
        {"connected": NAN},
    ],
)
def test_thresholds_that_make_no_sense_are_refused(wrong):
    with pytest.raises(ValueError, match="one half"):
        LikelihoodConfig(**wrong)


def test_stricter_thresholds_leave_more_edges_unknown():
    looks = pulled(np.linspace(1.0, 4.0, COUNT), np.linspace(0.0, 4.0, COUNT), np.linspace(0.0, 4.0, COUNT))
    unknown = [int((judge(looks, **t).state == EdgeState.UNKNOWN).sum()) for t in ({}, {"severed": 0.999, "connected": 0.01})]

    assert unknown[0] < unknown[1]


def test_evidence_without_weight_says_nothing():
    mute = Weights(**{field.name: 0.0 for field in fields(Weights)})
    graph = judge(pulled(3.0, WIDE, WIDE), weights=mute)

    assert graph.probability == pytest.approx(0.5)
    assert (graph.state == EdgeState.UNKNOWN).all()


# ------------------------------------------------------------ grooves and whole tissue


@pytest.mark.parametrize("rho", [1.0, 1.3, 1.8])
def test_where_nothing_was_expected_a_groove_alone_severs_nothing(rho):
    assert EdgeState.SEVERED not in states(judge(pulled(rho, parted=WIDE), None))


@pytest.mark.parametrize("rho", [3.0, 4.5, 8.0])
def test_where_nothing_was_expected_what_became_long_without_any_opening_is_unknown_at_most(rho):
    assert EdgeState.SEVERED not in states(judge(pulled(rho), None))


@pytest.mark.parametrize("rho", [0.9, 1.0, 1.2])
def test_where_nothing_was_expected_tissue_that_opened_nothing_and_kept_its_length_is_connected(rho):
    assert states(judge(pulled(rho), None)) == {EdgeState.CONNECTED}


def test_a_groove_is_never_less_likely_a_cut_than_tissue_that_opened_nothing():
    assert one(0.0, 0.0, 0.0, -1.0) <= one(12.0, 0.0, 0.0, -1.0)


@pytest.mark.parametrize(
    "wrong",
    [
        {"healed": 0.0},
        {"wide": 0.0},
        {"pixel_error": 0.0},
        {"model_error": -1.0},
        {"most": -1.0},
        {"slight": 0.0},
        {"weights": Weights(excess=9.0)},
        {"weights": Weights(parted=-0.1)},
    ],
)
def test_settings_that_make_no_sense_are_refused(wrong):
    with pytest.raises(ValueError):
        LikelihoodConfig(**wrong)


def unrecognised(which: Array, placed: bool) -> list[Look]:
    """Looks at tissue in which nothing opens, where the keypoints `which` are never seen, but may be `placed`."""
    found = tracks(keypoints(1.2), which)
    place = np.ones(len(GRID.points), dtype=bool) if placed else found.visible
    return [
        Look(step, found, place, openings(0.0), openings(0.0), openings(0.0), np.zeros(len(GRID.edges), dtype=bool))
        for step in range(1, STEPS + 1)
    ]


def test_beside_the_goal_a_place_is_enough_across_it_the_ends_must_be_seen() -> None:
    inner = GRID.edges[CROSSING[COUNT // 2]][:1]
    touched = np.isin(GRID.edges, inner).any(axis=1)

    graph, nowhere = judge(unrecognised(inner, placed=True)), judge(unrecognised(inner, placed=False))

    beside = touched & ~GRID.crosses_goal
    assert beside.any() and (graph.state[beside] == EdgeState.CONNECTED).all()
    assert (graph.state[touched & GRID.crosses_goal] == EdgeState.UNKNOWN).all()
    assert (nowhere.state[touched] == EdgeState.UNKNOWN).all()


def test_beside_the_goal_nothing_is_said_where_nobody_could_look_for_an_opening() -> None:
    inner = GRID.edges[CROSSING[COUNT // 2]][:1]
    blind = np.where(np.isin(GRID.edges, inner).any(axis=1), np.nan, openings(0.0))
    looks = [replace(look, parted=blind, bed=blind) for look in unrecognised(inner, placed=True)]

    assert (judge(looks).state[np.isnan(blind)] == EdgeState.UNKNOWN).all()
