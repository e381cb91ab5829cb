"""The gap along an edge is the width of what is dark between two lips, and nothing else counts as one."""

import numpy as np
import pytest

from hardware.interface import Array, Image
from skills.estimate.gap import GapConfig, GapWatch, darkest_along, gap_along

MIDDLE = np.array([100.0, 80.0])  # of the pictures; every slit runs through it
ANGLES = np.deg2rad([0.0, 17.0, 45.0, 90.0, 123.0])
ONE = np.array([[0, 1]])
LIP = 7.0  # [px] of tissue between an end of an edge and the slit


def across(angle: float) -> Array:
    """Unit vector (2,) across a slit that runs at `angle` [rad]."""
    return np.array([-np.sin(angle), np.cos(angle)])


def slit(width: float, angle: float = 0.0, bed: float = 15.0, falloff: float = 0.0, noise: float = 0.0) -> Image:
    """Tissue of 150 grey levels with a slit of `width` [px], its borders as a camera blends them; light falls off along u."""
    v, u = np.mgrid[0:160, 0:200].astype(np.float64)
    distance = abs((u - MIDDLE[0]) * across(angle)[0] + (v - MIDDLE[1]) * across(angle)[1])
    share = np.clip(width / 2 - distance + 0.5, 0.0, min(width, 1.0))
    grey = (150.0 * (1 - share) + bed * share) * (1 + falloff * (u - MIDDLE[0]) / MIDDLE[0])
    rgb = grey[..., None] * np.array([1.0, 0.6, 0.5])
    rgb = rgb + np.random.default_rng(1).normal(0.0, noise, rgb.shape)
    return np.asarray(np.clip(np.rint(rgb), 0, 255), dtype=np.uint8)


def edge(half: float, direction: Array, middle: Array = MIDDLE) -> Array:
    """Ends (2, 2) of an edge of length 2 `half` [px]."""
    return np.array([middle - half * direction, middle + half * direction])


@pytest.mark.parametrize("noise", [0.0, 2.0])
@pytest.mark.parametrize("angle", ANGLES)
@pytest.mark.parametrize("width", [2.0, 2.5, 3.0, 5.0, 8.0, 15.0, 30.0])
def test_a_slit_is_measured_to_a_pixel(width, angle, noise):
    image = slit(width, angle, noise=noise)

    widths = [
        gap_along(image, edge(width / 2 + LIP, across(angle), MIDDLE + shift * across(angle - np.pi / 2)), ONE)[0]
        for shift in (-9.3, -4.0, 0.0, 2.6, 7.5)
    ]

    assert widths == pytest.approx([width] * 5, abs=1.0)


@pytest.mark.parametrize("width", [60.0, 100.0, 140.0])
def test_an_opening_much_wider_than_its_lips_is_measured_too(width):
    image = np.repeat(slit(width / 2), 2, axis=0)  # twice as high, so that it fits

    assert gap_along(image, edge(width / 2 + LIP, across(0.0), np.array([100.0, 160.5])), ONE)[0] == pytest.approx(width, abs=2.0)


@pytest.mark.parametrize("slant", np.deg2rad([20.0, 40.0]))
def test_an_edge_that_crosses_a_slit_at_a_slant_lies_in_it_for_longer(slant):
    width = gap_along(slit(8.0), edge(20.0, across(slant)), ONE)[0]

    assert width == pytest.approx(8.0 / np.cos(slant), abs=1.0)


@pytest.mark.parametrize("shift", [-6.0, 6.0])
def test_where_on_the_edge_the_slit_lies_does_not_matter(shift):
    width = gap_along(slit(5.0), edge(20.0, across(0.0), MIDDLE + shift * across(0.0)), ONE)[0]

    assert width == pytest.approx(5.0, abs=1.0)


@pytest.mark.parametrize("angle", ANGLES)
def test_closed_tissue_has_no_gap(angle):
    assert gap_along(slit(0.0, noise=2.0), edge(20.0, across(angle)), ONE)[0] == 0.0


@pytest.mark.parametrize("width", [2.0, 12.0])
def test_light_that_falls_off_across_the_picture_does_not_matter(width):
    upright = np.pi / 2
    image = slit(width, upright, falloff=-0.8, noise=2.0)

    assert gap_along(image, edge(width / 2 + 25.0, across(upright)), ONE)[0] == pytest.approx(width, abs=1.0)


def test_light_that_falls_off_is_no_gap():
    image = slit(0.0, falloff=-0.8, noise=2.0)

    assert gap_along(image, edge(90.0, np.array([1.0, 0.0])), ONE)[0] == 0.0


@pytest.mark.parametrize("width", [4.0, 20.0])
def test_a_shallow_shadow_is_no_gap(width):
    image = slit(width, bed=0.7 * 150.0, noise=2.0)

    assert gap_along(image, edge(width / 2 + LIP, across(0.0)), ONE)[0] == 0.0


def test_what_is_bright_in_one_colour_is_no_gap():
    blood = slit(12.0)
    blood[..., 0] = 150

    assert gap_along(blood, edge(20.0, across(0.0)), ONE)[0] == 0.0


def test_of_two_slits_the_wider_one_counts():
    image = np.minimum(slit(4.0), np.roll(slit(9.0), 25, axis=0))

    width = gap_along(image, np.array([[100.0, 65.0], [100.0, 125.0]]), ONE)[0]

    assert width == pytest.approx(9.0, abs=1.0)


@pytest.mark.parametrize(
    "end",
    [
        (np.nan, 90.0),
        (100.0, np.nan),
        (np.inf, 90.0),
        (100.0, -np.inf),
        (-0.5, 90.0),
        (199.5, 90.0),
        (100.0, -0.5),
        (100.0, 159.5),
    ],
)
def test_an_edge_that_leaves_the_picture_has_no_known_gap_and_others_keep_theirs(end):
    points = np.array([[100.0, 70.0], end, [100.0, 90.0]])

    widths = gap_along(slit(6.0), points, np.array([[0, 1], [1, 0], [0, 2]]))

    assert np.isnan(widths[:2]).all()
    assert widths[2] == pytest.approx(6.0, abs=1.0)


def test_an_edge_along_the_pictures_border_is_seen():
    corners = np.array([[0.0, 0.0], [0.0, 159.0], [199.0, 0.0], [199.0, 159.0]])

    assert gap_along(slit(6.0), corners, np.array([[0, 1], [2, 3]])) == pytest.approx([6.0, 6.0], abs=1.0)


def test_an_edge_without_length_has_no_gap():
    assert gap_along(slit(6.0), np.array([[100.0, 80.0], [100.0, 80.0]]), ONE)[0] == 0.0


def test_no_edges_have_no_gaps():
    assert gap_along(slit(6.0), np.zeros((0, 2)), np.zeros((0, 2), dtype=np.int64)).shape == (0,)


def test_each_edge_is_judged_by_itself():
    points = np.array([[60.0, 65.0], [60.0, 95.0], [120.0, 20.0], [120.0, 50.0], [140.0, 65.0], [140.0, 95.0]])
    image = slit(6.0)
    image[:, 130:] = (slit(12.0) // 2)[:, 130:]

    assert gap_along(image, points, np.array([[0, 1], [2, 3], [4, 5]])) == pytest.approx([6.0, 0.0, 12.0], abs=1.0)


def test_many_edges_of_one_length_give_what_each_gives_alone():
    image = slit(7.0, 0.3, noise=2.0)
    rng = np.random.default_rng(3)
    directions = [across(angle) for angle in rng.uniform(-0.6, 1.2, 40)]
    middles = MIDDLE + rng.uniform(-15.0, 15.0, (40, 1)) * np.array([np.cos(0.3), np.sin(0.3)])
    equal = np.concatenate([edge(17.9, d, m) for d, m in zip(directions, middles, strict=True)])
    edges = np.arange(80).reshape(40, 2)

    together = gap_along(image, equal, edges)

    alone = np.array([gap_along(image, equal, one[None])[0] for one in edges])
    assert np.array_equal(together, alone)
    assert together.min() > 5.0


def test_a_longer_edge_beside_it_changes_a_width_by_less_than_two_samples():
    image = slit(7.0, noise=2.0)
    points = np.concatenate([edge(half, across(0.1)) for half in np.linspace(10.0, 70.0, 40)])
    edges = np.arange(80).reshape(40, 2)

    together = gap_along(image, points, edges)

    alone = np.array([gap_along(image, points, one[None])[0] for one in edges])
    assert np.abs(together - alone).max() < 2 * GapConfig().sample


def test_the_picture_is_left_as_it_was():
    image = slit(7.0)
    before = image.copy()

    gap_along(image, edge(20.0, across(0.0)), ONE)

    assert np.array_equal(image, before)


# Against the reference picture


def widened(*widths: float) -> object:
    """About these widths [px]: where the tissue was evenly bright, a slit's blurred borders count as well."""
    return pytest.approx([width + 1.5 for width in widths], abs=1.6)


@pytest.mark.parametrize("angle", ANGLES)
@pytest.mark.parametrize("width", [4.0, 12.0])
def test_a_faint_slit_counts_where_the_tissue_was_evenly_bright(width, angle):
    before, now = slit(0.0, noise=2.0), slit(width, angle, bed=0.8 * 150.0, noise=2.0)
    ends = edge(width / 2 + LIP, across(angle))

    measured = gap_along(now, ends, ONE, darkest_before=darkest_along(before, ends, ONE))

    assert measured == widened(width)
    assert gap_along(now, ends, ONE)[0] == 0.0


@pytest.mark.parametrize("vessel", [0.95, 0.85, 0.7, 0.5])
def test_what_was_dark_before_is_no_gap_unless_it_is_very_dark(vessel):
    picture = slit(6.0, bed=vessel * 150.0, noise=2.0)
    ends = edge(20.0, across(0.0))

    measured = gap_along(picture, ends, ONE, darkest_before=darkest_along(picture, ends, ONE))

    assert measured[0] == (pytest.approx(6.0, abs=1.5) if vessel < GapConfig().dark else 0.0)


def test_a_slit_beside_a_vessel_counts_only_if_it_is_darker():
    before = slit(6.0, bed=0.85 * 150.0)
    ends = np.array([[100.0, 55.0], [100.0, 115.0]])
    darkest = darkest_along(before, ends, ONE)

    for bed, width in ((0.83, 0.0), (0.72, 8.0)):
        now = np.minimum(before, np.roll(slit(8.0, bed=bed * 150.0), 18, axis=0))
        assert gap_along(now, ends, ONE, darkest_before=darkest)[0] == pytest.approx(width, abs=1.0)


def test_an_edge_that_was_not_seen_before_is_judged_without_a_reference():
    ends = np.concatenate([edge(12.0, across(0.0)), edge(12.0, across(0.0), MIDDLE + np.array([40.0, 0.0]))])
    edges = np.array([[0, 1], [2, 3]])

    faint = gap_along(slit(6.0, bed=0.8 * 150.0), ends, edges, darkest_before=np.array([np.nan, 0.99]))
    dark = gap_along(slit(6.0), ends, edges, darkest_before=np.array([np.nan, 0.99]))

    assert faint[0] == 0.0
    assert dark[0] == pytest.approx(6.0, abs=1.0)
    assert [faint[1], dark[1]] == widened(6.0, 6.0)


def test_noise_and_falling_light_are_no_gap_against_a_reference():
    rng = np.random.default_rng(7)
    ends = rng.uniform([20.0, 20.0], [180.0, 140.0], (60, 2))
    edges = np.arange(60).reshape(30, 2)
    before, now = slit(0.0, falloff=-0.3, noise=2.0), slit(0.0, falloff=-0.35, noise=2.0)[::-1]

    short = edges[np.linalg.norm(ends[edges[:, 0]] - ends[edges[:, 1]], axis=1) < 60.0]

    assert len(short) > 5
    assert (gap_along(now, ends, short, darkest_before=darkest_along(before, ends, short)) == 0.0).all()


@pytest.mark.parametrize("share", [0.2, 0.5, 0.8])
def test_the_darkest_place_is_a_share_of_the_brightness_at_the_ends(share):
    picture = slit(8.0, bed=share * 150.0)

    assert darkest_along(picture, edge(20.0, across(0.0)), ONE)[0] == pytest.approx(share, abs=0.02)
    assert darkest_along(picture // 2, edge(20.0, across(0.0)), ONE)[0] == pytest.approx(share, abs=0.03)


def test_the_darkest_place_of_an_edge_that_leaves_the_picture_is_not_known():
    points = np.array([[100.0, 70.0], [100.0, np.nan], [100.0, 90.0], [-3.0, 80.0]])

    darkest = darkest_along(slit(6.0), points, np.array([[0, 1], [0, 2], [2, 3]]))

    assert np.isnan(darkest).tolist() == [True, False, True]


# Watched over time

ENDS = np.concatenate([edge(20.0, across(0.0), MIDDLE + np.array([x, 0.0])) for x in (-40.0, 40.0)])
TWO = np.array([[0, 1], [2, 3], [0, 2]])
CROSSES = np.array([True, True, False])
ALL = np.ones(4, dtype=bool)


def watched(*widths: float) -> GapWatch:
    """A watch over two edges across the goal that looked at slits of these widths [px] after closed tissue at t_d."""
    watch = GapWatch(slit(0.0), ENDS, TWO, CROSSES)
    for width in widths:
        watch.look(slit(width), ENDS, ALL)
    return watch


def test_the_widest_opening_is_kept_when_it_closes_again():
    assert watched(4.0, 9.0, 9.0, 3.0, 0.0).parted()[:2] == widened(9.0, 9.0)


def test_a_faint_slit_that_opens_while_it_is_watched_counts():
    watch = watched()
    for _ in range(2):
        watch.look(slit(9.0, bed=0.8 * 150.0), ENDS, ALL)

    assert watch.parted()[:2] == widened(9.0, 9.0)


def test_what_is_seen_in_one_look_only_does_not_count():
    assert (watched(0.0, 12.0, 0.0, 0.0).parted()[:2] == 0.0).all()


def test_an_opening_that_grows_counts_as_wide_as_it_was_twice():
    assert watched(4.0, 8.0, 12.0).parted()[:2] == widened(8.0, 8.0)


def test_a_slit_that_is_open_only_at_first_counts():
    watch = GapWatch(slit(6.0), ENDS, TWO, CROSSES)
    for width in (6.0, 0.0, 0.0):
        watch.look(slit(width), ENDS, ALL)

    assert watch.parted()[:2] == pytest.approx([6.0, 6.0], abs=1.0)


def test_an_edge_along_the_goal_shows_no_opening_where_those_across_it_do():
    assert watched(9.0, 9.0).parted() == widened(9.0, 9.0, 0.0)


def test_the_bed_is_seen_through_a_dark_opening_and_not_in_a_groove():
    groove = watched()
    for _ in range(2):
        groove.look(slit(9.0, bed=0.8 * 150.0), ENDS, ALL)

    assert watched(9.0, 9.0).bed()[:2] == widened(9.0, 9.0)
    assert (groove.bed()[:2] == 0.0).all()


def test_an_end_that_came_to_lie_in_the_opening_does_not_hide_it():
    ends = np.concatenate([edge(20.0, across(0.0), MIDDLE + np.array([x, 0.0])) for x in range(-60, 61, 20)])
    edges = np.arange(len(ends)).reshape(-1, 2)
    watch = GapWatch(slit(0.0), ends, edges, np.ones(len(edges), dtype=bool))
    ends[0] = (ends[0] + ends[1]) / 2
    for _ in range(2):
        watch.look(slit(16.0), ends, np.ones(len(ends), dtype=bool))

    assert watch.parted() == pytest.approx([9.0, *6 * [18.0]], abs=1.5)


def test_what_passes_under_a_tool_is_left_out():
    watch, tools = watched(), np.zeros(slit(0.0).shape[:2], dtype=bool)
    left, top = (ENDS[0] + ENDS[1]) / 2 - 3.0
    tools[int(top) : int(top) + 6, int(left) : int(left) + 6] = True
    for _ in range(2):
        watch.look(slit(9.0), ENDS, ALL, tools)

    assert np.isnan(watch.parted()[0]) and watch.parted()[1:2] == widened(9.0)


def test_before_a_second_look_nothing_is_known():
    assert np.isnan(watched().parted()).all()


def test_an_end_that_is_not_seen_leaves_its_edge_out():
    watch = watched()
    for seen in (ALL, np.array([False, True, True, True])) * 2:
        watch.look(slit(9.0), ENDS, seen)

    widest = watch.parted()

    # The first edge was never seen open in two looks in a row.
    assert widest[0] == 0.0
    assert widest[1:2] == widened(9.0)


def test_an_edge_is_followed_where_its_ends_go():
    watch = watched()
    for shift in (5.0, 10.0, 15.0):
        watch.look(np.roll(slit(7.0), int(shift), axis=0), ENDS + np.array([0.0, shift]), ALL)

    assert watch.parted()[:2] == widened(7.0, 7.0)


def test_a_vessel_that_was_there_at_first_is_no_opening():
    vessel = slit(6.0, bed=0.75 * 150.0, noise=2.0)
    watch = GapWatch(vessel, ENDS, TWO, CROSSES)
    for _ in range(3):
        watch.look(vessel, ENDS, ALL)

    assert (watch.parted()[:2] == 0.0).all()


def test_what_is_dark_at_first_is_a_slit_if_the_tissue_was_even_before_it_was_cut():
    slit_at_first = slit(6.0, bed=0.75 * 150.0, noise=2.0)
    watch = GapWatch(slit_at_first, ENDS, TWO, CROSSES, (), np.array([0.99, 0.75, np.nan]))
    for _ in range(2):
        watch.look(slit_at_first, ENDS, ALL)

    assert watch.slit() == pytest.approx([6.0, 0.0, 0.0], abs=1.0)  # a vessel lay where the second edge is now
    assert (watch.parted() == 0.0).all()


def test_a_strand_thinner_than_the_grid_keeps_the_edge_beside_it_from_counting_as_parted():
    image = np.full((120, 160, 3), 200, np.uint8)
    image[52:68, 20:140] = 40
    image[52:68, 66:71] = 200  # bright tissue across the slit, between the lines at u = 60 and u = 80
    u = np.array([40.0, 60.0, 80.0, 100.0])
    points = np.concatenate([np.column_stack([u, np.full(4, 40.0)]), np.column_stack([u, np.full(4, 80.0)])])
    edges = np.column_stack([np.arange(4), np.arange(4) + 4])
    widths = []
    for between in ((), (-0.375, 0.375)):
        watch = GapWatch(image, points, edges, np.ones(4, dtype=bool), between)
        watch.look(image, points, np.ones(8, dtype=bool))
        widths.append(watch.parted())

    assert (widths[0] > 12).all()
    assert widths[1][1] < 1.0
    assert (widths[1][[0, 3]] > 12).all()


# Light that changes, and edges of which none crosses the goal


@pytest.mark.parametrize("share", [0.7, 0.85, 1.25])
@pytest.mark.parametrize("falloff", [0.0, -0.4])
def test_light_that_dims_or_brightens_opens_nothing(share, falloff):
    def lit(by: float, seed: int) -> Image:
        noise = np.random.default_rng(seed).normal(0.0, 2.0, (160, 200, 3))
        return np.asarray(np.clip(by * slit(0.0, falloff=falloff) + noise, 0, 255), dtype=np.uint8)

    watch = GapWatch(lit(1.0, 0), ENDS, TWO, CROSSES)
    for look in range(1, 5):
        watch.look(lit(share, look), ENDS, ALL)

    assert (watch.parted() == 0.0).all()
    assert (watch.bed() == 0.0).all()


def test_a_slit_is_as_wide_in_a_light_that_has_dimmed_by_a_third():
    watch = watched()
    for _ in range(2):
        watch.look((0.7 * slit(9.0)).astype(np.uint8), ENDS, ALL)

    assert watch.parted()[:2] == widened(9.0, 9.0)
    assert watch.bed()[:2] == widened(9.0, 9.0)


def test_a_light_that_dims_makes_no_bed_of_a_groove():
    watch = watched()
    for _ in range(2):
        watch.look((0.7 * slit(9.0, bed=0.8 * 150.0)).astype(np.uint8), ENDS, ALL)

    assert watch.parted()[:2] == widened(9.0, 9.0)
    assert (watch.bed()[:2] == 0.0).all()


NONE_CROSSES = np.zeros(3, dtype=bool)


def test_an_edge_away_from_the_goal_parts_like_one_across_it():
    watch = GapWatch(slit(0.0), ENDS, TWO, NONE_CROSSES, (-0.375, 0.375))
    for _ in range(2):
        watch.look(slit(9.0), ENDS, ALL)

    assert watch.parted() == widened(9.0, 9.0, 0.0)
    assert watch.bed() == widened(9.0, 9.0, 0.0)


def test_an_edge_away_from_the_goal_shows_a_groove_without_bed():
    watch = GapWatch(slit(0.0), ENDS, TWO, NONE_CROSSES)
    for _ in range(2):
        watch.look(slit(9.0, bed=0.8 * 150.0), ENDS, ALL)

    assert watch.parted()[:2] == widened(9.0, 9.0)
    assert (watch.bed() == 0.0).all()


def test_only_edges_across_the_goal_must_be_open_beside_themselves_too():
    image = slit(9.0)
    image[:, 75:84] = slit(0.0)[:, 75:84]  # a strand between the two edges, nearer to the first
    for crosses, bridged in ((CROSSES, True), (NONE_CROSSES, False)):
        watch = GapWatch(slit(0.0), ENDS, TWO, crosses, (0.24,))
        for _ in range(2):
            watch.look(image, ENDS, ALL)
        widths = watch.parted()
        assert (widths[0] == 0.0) == bridged
        assert widths[1:2] == widened(9.0)


def test_what_was_told_of_the_bed_does_not_change_with_the_next_look():
    watch = watched(6.0, 6.0)
    before = watch.bed()
    kept = before.copy()
    for _ in range(2):
        watch.look(slit(15.0), ENDS, ALL)

    assert np.array_equal(before, kept, equal_nan=True)
    assert watch.bed()[0] > kept[0] + 5.0


def test_bed_and_opening_are_never_wider_than_one_another_allows():
    for width in (3.0, 8.0, 14.0):
        for bed in (15.0, 80.0, 0.8 * 150.0):
            watch = watched()
            for _ in range(2):
                watch.look(slit(width, bed=bed, noise=2.0), ENDS, ALL)
            assert (watch.bed() <= watch.parted()).all()


# What is decided


def test_an_opening_that_shows_the_bed_is_decided_by_as_much_of_it_as_is_seen():
    watch = watched(9.0, 9.0)

    assert np.array_equal(watch.decided()[:2], watch.bed()[:2])
    assert watch.decided()[:2] == widened(9.0, 9.0)


def test_where_nothing_opened_it_is_decided_that_nothing_did():
    assert (watched(0.0, 0.0).decided() == 0.0).all()


def test_a_groove_decides_nothing():
    watch = watched()
    for _ in range(2):
        watch.look(slit(9.0, bed=0.8 * 150.0), ENDS, ALL)

    assert np.isnan(watch.decided()[:2]).all()
    assert watch.decided()[2] == 0.0


def test_a_groove_that_opens_to_the_bed_later_is_decided_then():
    watch = watched()
    for bed in (0.8 * 150.0, 0.8 * 150.0, 15.0, 15.0):
        watch.look(slit(9.0, bed=bed), ENDS, ALL)

    assert watch.decided()[:2] == widened(9.0, 9.0)


def test_what_could_not_be_looked_at_decides_nothing():
    watch = watched()
    for _ in range(2):
        watch.look(slit(9.0), ENDS, np.array([False, True, True, True]))

    assert np.isnan(watch.decided()[[0, 2]]).all()
    assert watch.decided()[1:2] == widened(9.0)


# ------------------------------------------------------------ strands between the edges

ROW = np.array([edge(30.0, across(0.0), np.array([u, 80.5])) for u in (80.0, 90.0, 100.0, 110.0, 120.0)])
ROW_EDGES = np.arange(10).reshape(-1, 2)


def opening(width: float, strand: float = 0.0, at: float = 105.0, until: float = 1.0, bright: float = 150.0) -> Image:
    """A slit of `width` [px] with a `strand` [px] at u = `at` that reaches `until` of the way through it."""
    picture = slit(width)
    top, far = round(80 - width / 2), round(80 + width / 2)
    first = round(at - strand / 2)
    picture[top : round(top + until * (far - top)) + 1, first : first + round(strand)] = bright * np.array([1.0, 0.6, 0.5])
    return picture


def stranded(*pictures: Image) -> list[bool]:
    """Which of the edges lie beside a strand after these looks."""
    watch = GapWatch(slit(0.0), ROW.reshape(-1, 2), ROW_EDGES, np.ones(len(ROW_EDGES), dtype=bool))
    for picture in pictures:
        watch.look(picture, ROW.reshape(-1, 2), np.ones(2 * len(ROW), dtype=bool))
    return [bool(value) for value in watch.stranded()]


BESIDE = [False, False, True, True, False]


@pytest.mark.parametrize("width", [5.0, 12.0, 30.0])
@pytest.mark.parametrize("strand", [3.0, 5.0])
def test_a_strand_between_two_edges_is_seen_by_both(width, strand):
    assert stranded(*[opening(width, strand)] * 2) == BESIDE


def test_a_strand_that_is_seen_from_its_dark_cut_side_holds_all_the_same():
    assert stranded(*[opening(30.0, 3.0, bright=105.0)] * 2) == BESIDE


def test_two_strips_that_hang_down_past_each_other_bar_no_way():
    picture = opening(30.0, 3.0, at=103.0, until=0.7)
    picture[80:97, 107:110] = (150, 90, 75)  # from the far lip up

    assert stranded(picture, picture) == [False] * 5


def test_a_strand_counts_when_seen_twice_and_no_more_when_missed_twice():
    there, torn = opening(30.0, 3.0), opening(30.0)

    assert stranded(there) == [False] * 5
    assert stranded(there, there, torn) == BESIDE
    assert stranded(there, there, torn, torn) == [False] * 5


@pytest.mark.parametrize(
    "picture",
    [
        opening(30.0),
        opening(30.0, 3.0, until=0.5),
        opening(30.0, 3.0, until=0.85),
        opening(30.0, 3.0, bright=50.0),
        opening(2.0, 3.0),
    ],
    ids=["nothing", "torn at one end", "torn, and long", "a ridge of the bed", "too narrow to look into"],
)
def test_what_does_not_hold_the_lips_together_is_no_strand(picture):
    assert stranded(picture, picture) == [False] * 5


def test_under_a_tool_a_strand_stays_where_it_was_seen():
    watch = GapWatch(slit(0.0), ROW.reshape(-1, 2), ROW_EDGES, np.ones(len(ROW_EDGES), dtype=bool))
    hidden = np.zeros((160, 200), dtype=bool)
    hidden[:, 95:115] = True
    everywhere = np.ones(2 * len(ROW), dtype=bool)
    for picture, mask in [(opening(30.0, 3.0), None)] * 2 + [(opening(30.0), hidden)] * 3:
        watch.look(picture, ROW.reshape(-1, 2), everywhere, mask)

    assert list(watch.stranded()) == BESIDE
