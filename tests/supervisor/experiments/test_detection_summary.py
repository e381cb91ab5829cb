"""The figures of the detection experiment, from counts made by hand."""

import numpy as np
import pytest

from supervisor.experiments.detection_summary import rates, rows, summary, times
from supervisor.experiments.detection_trial import BINS
from tests.supervisor.experiments.detection_runs import counts, failed, run


def test_rates_are_those_of_the_hand_made_counts():
    figures = rates([counts(ss=6, sc=1, su=1, cs=1, cc=20, cu=3, squared_error=1.6), counts(ss=2, sc=1, cc=5, squared_error=0.4)])

    assert figures["edges"] == 40
    assert figures["detection_accuracy"] == pytest.approx(33 / 36)
    assert figures["accuracy_unknown_wrong"] == pytest.approx(33 / 40)
    assert figures["precision"] == pytest.approx(8 / 9)
    assert figures["recall"] == pytest.approx(8 / 10)
    assert figures["balanced_accuracy"] == pytest.approx((8 / 10 + 25 / 26) / 2)
    assert figures["false_severed_rate"] == pytest.approx(1 / 29)
    assert figures["unknown_rate"] == pytest.approx(4 / 40)
    assert figures["brier"] == pytest.approx(2.0 / 40)
    assert figures["confusion"]["connected"] == {"severed": 1, "connected": 25, "unknown": 3}


def test_each_share_lies_in_its_interval():
    figures = rates([counts(ss=6, sc=1, su=1, cs=1, cc=20, cu=3)])

    assert all(low <= figures[name] <= high for name, (low, high) in figures["wilson"].items())
    assert figures["wilson"].keys() >= {"detection_accuracy", "false_severed_rate", "unknown_rate", "recall"}


def test_shares_of_nothing_are_unknown():
    figures = rates([counts(cc=4)])

    assert figures["recall"] is None
    assert figures["balanced_accuracy"] is None
    assert rates([])["detection_accuracy"] is None


def test_the_reliability_says_for_each_bin_what_was_predicted_and_what_was_true():
    bins = [[0, 0.0, 0]] * BINS
    first, second = counts(), counts()
    first["bins"], second["bins"] = [*bins[:7], [4, 3.0, 2], *bins[8:]], [*bins[:7], [4, 2.9, 3], *bins[8:]]

    reliability = rates([first, second])["reliability"]

    assert len(reliability) == BINS
    assert reliability[7] == {
        "from": 0.7,
        "to": 0.8,
        "count": 8,
        "mean_predicted": pytest.approx(5.9 / 8),
        "share_severed": 5 / 8,
    }
    assert reliability[0]["mean_predicted"] is None


def test_figures_are_sorted_by_material_cut_and_disturbance():
    runs = [
        run(0),
        run(1, scene="chicken", cut="fully", disturbance="blur", edges=counts(ss=10)),
        failed(seed=2, scene="chicken"),
    ]

    figures = summary(runs)

    assert figures["by_material"]["chicken"]["detection_accuracy"] == 1.0
    assert figures["by_material"]["chicken"]["cases"] == 1
    assert figures["by_material"]["beef"]["detection_accuracy"] == pytest.approx(17 / 20)
    assert figures["by_cut"]["fully"]["edges"] == 10
    assert figures["by_disturbance"]["blur"]["edges"] == 10
    assert figures["detection_accuracy"] == pytest.approx(27 / 30)


def test_goal_edges_have_figures_of_their_own():
    figures = summary([run(edges=counts(cc=10), goal_edges=counts(ss=1, sc=1))])

    assert figures["detection_accuracy"] == 1.0
    assert figures["goal_edges"]["detection_accuracy"] == 0.5
    assert figures["goal_edges"]["by_material"]["beef"]["recall"] == 0.5


def test_cases_that_could_not_be_judged_are_counted_and_told():
    figures = summary([run(0), failed(seed=1)])

    assert figures["not_judged"] == 1
    assert figures["codes"] == {"grasp_empty": 1, "ok": 1}
    assert figures["per_case"][1]["edges"] is None
    assert figures["per_case"][0]["goal_edges"]["severed"]["severed"] == 8


def test_times_are_those_of_all_frames_together():
    figures = times([run(ms=[10.0] * 99), run(ms=[110.0], points=310)])

    assert figures["mean"] == pytest.approx(11.0)
    assert figures["p99"] == pytest.approx(np.percentile([10.0] * 99 + [110.0], 99))
    assert figures["points"] == {"mean": 305.0, "max": 310}
    assert times([failed()])["mean"] is None


def test_rows_of_edges_say_whose_they_are():
    made = rows([run(7, variant="lk"), failed(seed=8)])

    assert len(made) == 1
    assert (made[0]["seed"], made[0]["variant"], made[0]["station"]) == (7, "lk", 0.5)
