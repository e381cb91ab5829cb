"""Truth from the mesh: attachments, lengths and ratios of cuts whose answer is known."""

import numpy as np
import pytest

from hardware.stub.phantom import Phantom
from hardware.stub.scene import load_scene
from hardware.stub.truth import measure, severed_between


@pytest.fixture
def phantom() -> Phantom:
    return Phantom(load_scene("silicone"), 0, 4.5, 1 / 120)


def cut(phantom: Phantom, *stretches: tuple[float, float], y: float = 0.0, damage: float = 1.0) -> None:
    """Straight cuts from x to x [mm] at y [mm]."""
    for a, b in stretches:
        phantom.cut([(np.array([[a, y], [b, y]]) * 1e-3, damage)])


def test_nothing_cut_is_one_attachment_over_the_whole_goal(phantom):
    truth = measure(phantom)

    assert truth.attachments == 1
    assert truth.attachment_stretches == ((0.0, pytest.approx(0.040)),)
    assert truth.length_deviation == pytest.approx(0.040)
    assert truth.effective_cut_ratio == 0.0


def test_every_gap_between_cuts_is_one_attachment(phantom):
    cut(phantom, (-20, -8), (-6.5, 5), (6.5, 20))

    truth = measure(phantom)
    assert truth.attachments == 2
    assert truth.severed_length == pytest.approx(0.037, abs=1e-3)
    assert [round(low * 1e3) for low, _ in truth.attachment_stretches] == [12, 25]


def test_a_strand_of_one_millimetre_is_found(phantom):
    cut(phantom, (-20, -0.5), (0.5, 20))

    assert measure(phantom).attachments == 1


def test_a_cut_too_short_is_a_deviation_and_no_attachment(phantom):
    cut(phantom, (-20, 16))

    truth = measure(phantom)
    assert truth.attachments == 0
    assert truth.length_deviation == pytest.approx(4e-3, abs=0.5e-3)
    assert not truth.success


def test_a_cut_too_long_is_a_deviation_too(phantom):
    cut(phantom, (-20, 25))

    truth = measure(phantom)
    assert truth.length_deviation == pytest.approx(5e-3, abs=0.5e-3)
    assert truth.excessive_cut_ratio == pytest.approx(0.125, abs=0.03)


def test_a_cut_far_from_the_goal_does_not_count_as_executing_it(phantom):
    cut(phantom, (-20, 20), y=5.0)

    truth = measure(phantom)
    assert truth.effective_cut_ratio == 0.0
    assert truth.excessive_cut_ratio == pytest.approx(1.0, abs=0.05)


def test_overlapping_cuts_side_by_side_leave_a_strand(phantom):
    cut(phantom, (-20, 2), y=1.0)
    cut(phantom, (-2, 20), y=-1.0)

    assert measure(phantom).attachments == 1


def test_a_stray_cut_beside_a_whole_one_adds_no_attachment(phantom):
    cut(phantom, (-20, 20))
    cut(phantom, (-5, 5), y=2.0)

    assert measure(phantom).attachments == 0


def test_partly_severed_tissue_still_counts_as_attached(phantom):
    cut(phantom, (-20, 20), damage=0.8)

    assert measure(phantom).attachments == 1


def test_material_segments_across_a_cut_are_severed_and_others_are_not(phantom):
    cut(phantom, (-10, 10))
    a = np.array([[0.0, -1.0], [15.0, -1.0], [0.0, 1.0]]) * 1e-3
    b = np.array([[0.0, 1.0], [15.0, 1.0], [0.0, 3.0]]) * 1e-3

    assert severed_between(phantom, a, b).tolist() == [True, False, False]
