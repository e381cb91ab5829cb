"""Readings that are invalid, late, repeated or lost, and clocks that differ (trap 14)."""

import numpy as np
import pytest

from hardware.dvrk.local import LocalGraph
from hardware.dvrk.messages import JointState, PoseStamped
from hardware.dvrk.telemetry import Event, Stream, joints_problem, pose_problem


class Line:
    """One topic between a robot and a listener whose clock says `time`."""

    def __init__(self, ahead: float = 0.0) -> None:
        self.time = 100.0
        graph = LocalGraph(lambda: self.time)
        self.robot = graph.node("robot", ahead)
        self.publisher = self.robot.publisher("/x", PoseStamped)
        self.stream = Stream(graph.node("driver"), "/x", PoseStamped, 100.0, pose_problem)

    def send(self, late: float = 0.0, stamp: float | None = None, x: float = 0.0, quaternion: tuple = (0, 0, 0, 1)) -> None:
        when = self.robot.stamp() - late if stamp is None else stamp
        self.publisher.publish(PoseStamped(when, "f", np.array([x, 0, 0]), np.array(quaternion, dtype=float)))

    def run(self, seconds: float, **how: object) -> None:
        for _ in range(round(seconds / 0.01)):
            self.time += 0.01
            self.send(**how)  # type: ignore[arg-type]

    @property
    def now(self) -> float:
        return self.time - 100.0

    def fresh(self) -> bool:
        return self.stream.sample().fresh(self.now, 0.1)


@pytest.mark.parametrize("ahead", [-5.0, 0.0, 5.0])
def test_a_clock_that_is_off_by_seconds_makes_no_reading_old_or_young(ahead: float):
    line = Line(ahead)

    line.run(1.0)

    assert line.fresh()
    assert line.stream.sample().good.taken == pytest.approx(line.now, abs=1e-5)


def test_a_message_that_was_long_under_way_is_as_old_as_that():
    line = Line()
    line.run(0.5)

    line.run(0.1, late=0.3)

    assert not line.fresh()


@pytest.mark.parametrize("ahead", [0.0, 5.0])
def test_stamps_that_stand_still_are_no_news(ahead: float):
    line = Line(ahead)
    line.run(0.5)

    line.run(0.3, stamp=line.robot.stamp())

    assert not line.fresh()


def test_a_clock_that_is_set_back_makes_all_data_late():
    line = Line()
    line.run(0.5)

    line.run(1.0, late=5.0)

    assert not line.fresh()


def test_a_clock_that_is_set_ahead_makes_all_data_invalid_until_it_is_set_right():
    line = Line()
    line.run(0.5)

    line.run(1.0, late=-5.0)

    assert not line.fresh() and "set ahead by 5.0 s" in line.stream.sample().problem
    line.run(0.01)
    assert line.fresh()


def test_first_messages_that_waited_for_long_are_no_clock_that_was_set():
    line = Line()

    line.run(0.1, late=3.0)
    line.run(0.3)

    assert line.fresh()


def test_silence_is_stale():
    line = Line()
    line.run(0.5)

    line.time += 0.15

    assert not line.fresh()


@pytest.mark.parametrize(
    ("how", "why"),
    [
        ({"stamp": 0.0}, "stamp 0"),
        ({"stamp": float("nan")}, "stamp is not finite"),
        ({"x": float("nan")}, "not finite"),
        ({"quaternion": (0, 0, 0, 0)}, "length 0.000"),
        ({"quaternion": (0, 0, 0, 0.9)}, "length 0.900"),
    ],
)
def test_an_invalid_reading_says_why_and_is_never_used(how: dict, why: str):
    line = Line()
    line.run(0.2, x=0.05)

    line.run(0.01, **how)

    sample = line.stream.sample()
    assert why in sample.problem and not line.fresh()
    assert sample.good.message.position[0] == 0.05


def test_seven_joints_are_no_six():
    state = JointState(1.0, (), np.zeros(7))

    assert joints_problem(6)(state) == "it reports 7 joints instead of 6"


def test_since_when_the_numbers_stand_still_is_told():
    line = Line()
    for k in range(20):
        line.run(0.01, x=1e-6 * k)
    moved = line.now

    line.run(0.4, x=1.0)

    assert line.stream.sample().unchanged_since == pytest.approx(moved + 0.01)


@pytest.mark.parametrize("moves", [True, False])
def test_numbers_that_never_stood_still_are_known_as_noisy_and_those_of_a_motion_are_not(moves: bool):
    rng = np.random.default_rng(0)
    line = Line()
    for k in range(200):
        line.run(0.01, x=1e-4 * k if moves else 1e-6 * rng.normal())
    assert line.stream.sample().noisy is not moves

    line.run(0.5, x=1.0)  # frozen, or at rest

    assert line.stream.sample().noisy is not moves


def test_numbers_that_flicker_now_and_then_are_not_noisy():
    rng = np.random.default_rng(0)
    line = Line()

    for _ in range(300):
        line.run(0.01, x=1e-6 * (rng.random() > 0.7))

    assert not line.stream.sample().noisy


def test_figures_tell_rate_gaps_losses_and_delays():
    line = Line()
    line.run(1.0)
    line.time += 0.05  # five messages lost
    line.run(1.0)
    line.run(0.02, late=0.03)
    line.run(0.01, stamp=0.0)

    figures = line.stream.figures()

    assert figures.received == 203 and figures.dropped == 5 and figures.invalid == 1
    assert figures.longest_gap == pytest.approx(0.06)
    assert figures.rate == pytest.approx(98, abs=1)
    assert figures.delay_median == pytest.approx(0.0, abs=1e-5)


def test_what_was_latched_before_the_command_is_not_heard_since_it():
    graph = LocalGraph(lambda: 5.0)
    graph.node("robot").publisher("/e", PoseStamped, latched=True).publish(PoseStamped(1, "", np.zeros(3), np.zeros(4)))
    event = Event(graph.node("driver"), "/e", PoseStamped, 0.0)

    assert event.newest() is not None
    assert event.since(5.1) is None
