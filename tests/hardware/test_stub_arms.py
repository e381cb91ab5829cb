"""The simulated arm: CRTK states, motion and its reports, imperfections, commanded faults."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hardware.codes import Code, InputError
from hardware.interface import GRASPER, Array, MoveReport, MoveStatus, OperatingState, Pose
from hardware.stub.arms import ArmConfig, StubArm, StubMove
from tests.mocks.bench import HOMES

STEP = 1 / 120
HOME = HOMES[GRASPER]
AHEAD = np.array([0.0, 0.0, 0.010])


class Rig:
    """One arm and its clock."""

    def __init__(self, config: ArmConfig | None = None, seed: int = 0, homed: bool = True) -> None:
        self.time = 0.0
        self.arm = StubArm(GRASPER, config or ArmConfig(), np.random.default_rng(seed), HOME, lambda: self.time)
        if homed:
            self.ready()

    def run(self, seconds: float, force: Array | None = None) -> None:
        """Step the arm as the bench does."""
        for _ in range(round(seconds / STEP)):
            self.arm.step(STEP, np.zeros(3) if force is None else force)
            self.time += STEP

    def ready(self) -> None:
        """Enable and home."""
        self.arm.state_command("enable")
        self.arm.state_command("home")
        self.run(0.6)
        assert self.arm.operating_state().ready

    def until_settled(self, move: StubMove, at_most: float = 10.0) -> MoveReport:
        """Run until `move` is no longer running."""
        while move.report().status is MoveStatus.RUNNING and at_most > 0:
            self.run(STEP)
            at_most -= STEP
        return move.report()


@pytest.fixture
def rig() -> Rig:
    return Rig()


# CRTK states

D, E, P, F = OperatingState.DISABLED, OperatingState.ENABLED, OperatingState.PAUSED, OperatingState.FAULT
TO_REACH = {D: [], E: ["enable"], P: ["enable", "pause"], F: ["enable"]}
ACCEPTANCE = {
    D: {"enable": E, "disable": D, "pause": D, "resume": D, "home": D, "unhome": D},
    E: {"enable": E, "disable": D, "pause": P, "resume": E, "home": E, "unhome": E},
    P: {"enable": P, "disable": D, "pause": P, "resume": E, "home": P, "unhome": P},
    F: {"enable": E, "disable": D, "pause": F, "resume": F, "home": F, "unhome": F},
}


@pytest.mark.parametrize("state", [D, E, P, F])
@pytest.mark.parametrize("command", ["enable", "disable", "pause", "resume", "home", "unhome", "dance"])
def test_state_commands_follow_crtks_acceptance_table(state: OperatingState, command: str) -> None:
    rig = Rig(homed=False)
    for step in TO_REACH[state]:
        rig.arm.state_command(step)
    if state is F:
        rig.arm.inject("fault")
        rig.arm.inject("clear")
    assert rig.arm.operating_state().state is state

    rig.arm.state_command(command)

    assert rig.arm.operating_state().state is ACCEPTANCE[state].get(command, state)


def test_homing_follows_enabling_takes_time_and_keeps_the_arm_busy() -> None:
    rig = Rig(homed=False)
    rig.arm.state_command("home")
    rig.run(1.0)
    too_early = rig.arm.operating_state().is_homed

    rig.arm.state_command("enable")
    rig.arm.state_command("home")
    homing = rig.arm.operating_state()
    rig.run(0.6)

    assert not too_early
    assert homing.is_busy and not homing.is_homed
    assert rig.arm.operating_state().ready and not rig.arm.operating_state().is_busy


# Motion


def test_a_move_goes_straight_at_the_free_speed_after_the_latency(rig: Rig) -> None:
    move = rig.arm.move_cp(HOME.moved(AHEAD))
    rig.run(0.04)
    before_latency = rig.arm.setpoint_cp().position
    rig.run(0.11)
    travelled = rig.arm.setpoint_cp().position - HOME.position

    assert (before_latency == HOME.position).all()
    assert travelled == pytest.approx([0.0, 0.0, 0.05 * 0.1], abs=0.05 * 2 * STEP)
    assert rig.until_settled(move).status is MoveStatus.DONE
    assert rig.arm.measured_cp().value.position == pytest.approx(HOME.position + AHEAD, abs=5e-5)


def test_position_and_orientation_arrive_together(rig: Rig) -> None:
    goal = Pose.looking(HOME.position + AHEAD, np.array([-0.8, 0.3, 0.5]), np.array([0.0, 1.0, 0.0]))
    angle = HOME.angle_to(goal)
    move = rig.arm.move_cp(goal)

    rig.run(0.05 + 0.5 * angle / 1.5)
    half = rig.arm.setpoint_cp()

    assert HOME.angle_to(half) == pytest.approx(angle / 2, abs=0.03)
    assert half.position == pytest.approx(HOME.position + AHEAD / 2, abs=3e-4)
    assert np.linalg.norm(half.quaternion) == pytest.approx(1.0)
    assert rig.until_settled(move).status is MoveStatus.DONE


def test_a_servo_command_is_followed_at_limited_speed(rig: Rig) -> None:
    rig.arm.servo_cp(HOME.moved(AHEAD))
    rig.run(0.05 + 0.1)

    assert rig.arm.setpoint_cp().position == pytest.approx(HOME.position + AHEAD)
    travelled = np.linalg.norm(rig.arm.true_pose().position - HOME.position)
    assert travelled == pytest.approx(0.05 * 0.1, abs=0.05 * 2 * STEP + 2e-4)


def test_the_jaw_closes_at_limited_speed(rig: Rig) -> None:
    move = rig.arm.move_jaw(0.0)
    rig.run(0.05 + 0.1)
    partly = rig.arm.true_jaw()

    assert partly == pytest.approx(0.7 - 0.2, abs=0.04)
    assert rig.until_settled(move).status is MoveStatus.DONE and rig.arm.true_jaw() == 0.0


def test_no_longer_busy_is_not_success_when_the_arm_faults_mid_move(rig: Rig) -> None:
    move = rig.arm.move_cp(HOME.moved(AHEAD))
    rig.run(0.1)
    was_busy = rig.arm.operating_state().is_busy

    rig.arm.inject("fault")
    rig.run(1.0)

    assert was_busy and not rig.arm.operating_state().is_busy
    assert move.report().status is MoveStatus.FAILED and move.report().code is Code.ARM_FAULT


@pytest.mark.parametrize(
    ("stop", "code"),
    [
        (lambda arm: arm.hold(), Code.MOVE_NOT_REACHED),
        (lambda arm: arm.state_command("pause"), Code.MOVE_NOT_REACHED),
        (lambda arm: arm.state_command("disable"), Code.MOVE_NOT_REACHED),
        (lambda arm: arm.inject("power_off"), Code.MOVE_NOT_REACHED),
        (lambda arm: arm.inject("fault"), Code.ARM_FAULT),
    ],
)
def test_whatever_stops_a_move_stops_tip_and_jaw_where_they_are(rig: Rig, stop, code: Code) -> None:  # type: ignore[no-untyped-def]
    move, jaw = rig.arm.move_cp(HOME.moved(AHEAD)), rig.arm.move_jaw(0.0)
    rig.run(0.15)
    stop(rig.arm)
    pose, opening = rig.arm.true_pose().position, rig.arm.true_jaw()

    rig.run(1.0)

    assert (rig.arm.true_pose().position == pose).all() and rig.arm.true_jaw() == opening
    assert HOME.position[2] < pose[2] < HOME.position[2] + AHEAD[2] and 0.0 < opening < 0.7
    assert move.report().code is code and jaw.report().code is code


def test_a_hold_also_stops_commands_that_are_still_on_their_way(rig: Rig) -> None:
    move = rig.arm.move_cp(HOME.moved(AHEAD))
    rig.arm.hold()
    rig.run(1.0)

    assert move.report().code is Code.MOVE_NOT_REACHED
    assert rig.arm.true_pose().position == pytest.approx(HOME.position, abs=1e-9)


def test_a_newer_command_takes_the_older_ones_place(rig: Rig) -> None:
    first = rig.arm.move_cp(HOME.moved(AHEAD))
    rig.run(0.1)
    second = rig.arm.move_cp(HOME)

    assert rig.until_settled(second).status is MoveStatus.DONE
    assert first.report().code is Code.MOVE_NOT_REACHED


@pytest.mark.parametrize("homed", [True, False])
def test_an_arm_that_is_not_ready_ignores_commands_and_says_so(homed: bool) -> None:
    rig = Rig(homed=homed)
    rig.arm.state_command("disable" if homed else "enable")
    rig.arm.servo_cp(HOME.moved(AHEAD))

    codes = [rig.arm.move_cp(HOME.moved(AHEAD)).report().code, rig.arm.move_jaw(0.0).report().code]
    rig.run(1.0)

    assert codes == [Code.MOVE_REJECTED] * 2
    assert rig.arm.true_pose().position == pytest.approx(HOME.position, abs=1e-9)


# Imperfections


def test_the_tip_is_off_by_the_bias_and_the_encoders_do_not_know() -> None:
    rig = Rig(ArmConfig(bias=(1e-3, -2e-3, 0.5e-3), bias_rotation=(0.0, 0.0, 0.02)))

    assert rig.arm.true_pose().position - HOME.position == pytest.approx([1e-3, -2e-3, 0.5e-3])
    assert rig.arm.true_pose().angle_to(HOME) == pytest.approx(0.02)
    assert rig.arm.measured_cp().value.position == pytest.approx(HOME.position, abs=5e-5)


def test_backlash_is_lost_at_each_reversal() -> None:
    rig = Rig(ArmConfig(backlash=0.4e-3))

    def after(offset: float) -> float:
        rig.until_settled(rig.arm.move_cp(HOME.moved(np.array([offset, 0.0, 0.0]))))
        return float(rig.arm.true_pose().position[0] - HOME.position[0])

    assert after(2e-3) == pytest.approx(1.8e-3)
    assert after(1.8e-3) == pytest.approx(1.8e-3)  # within the play: the tip stays
    assert after(0.0) == pytest.approx(0.2e-3)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.floats(-2e-3, 2e-3), min_size=1, max_size=6), st.floats(0, 1e-3))
def test_the_tip_is_never_further_from_the_encoders_than_half_the_play(offsets: list[float], backlash: float) -> None:
    rig = Rig(ArmConfig(backlash=backlash, encoder_noise=0.0))

    for offset in offsets:
        rig.arm.servo_cp(HOME.moved(np.array([offset, -offset, offset])))
        rig.run(0.1)
        play = np.abs(rig.arm.true_pose().position - rig.arm.measured_cp().value.position)
        assert (play <= backlash / 2 + 1e-12).all()


def test_the_force_is_measured_with_noise_of_the_stated_size(rig: Rig) -> None:
    force, samples = np.array([0.0, 2.0, 0.0]), []
    for _ in range(800):
        rig.run(STEP, force)
        samples.append(rig.arm.measured_cf().value)

    assert np.mean(samples, axis=0) == pytest.approx(force, abs=0.01)
    assert np.std(samples, axis=0) == pytest.approx(np.full(3, 0.05), rel=0.15)


def test_one_seed_gives_one_result_to_the_bit() -> None:
    def measure(seed: int) -> Array:
        rig = Rig(seed=seed)
        rig.arm.move_cp(HOME.moved(AHEAD))
        rig.run(0.5)
        return np.concatenate([rig.arm.measured_cp().value.position, rig.arm.measured_cf().value])

    assert (measure(3) == measure(3)).all()
    assert (measure(3) != measure(4)).any()


# Commanded faults


def test_stale_data_stand_still_while_the_arm_goes_on_and_prove_no_arrival(rig: Rig) -> None:
    move = rig.arm.move_cp(HOME.moved(AHEAD))
    rig.run(0.1)
    rig.arm.inject("stale")
    seen = rig.arm.measured_cp()

    rig.run(0.5)

    assert rig.arm.measured_cp() is seen and rig.arm.true_pose().position[2] > seen.value.position[2] + 5e-3
    assert not rig.arm.operating_state().is_busy and move.report().status is MoveStatus.RUNNING
    assert rig.until_settled(move).code is Code.MOVE_TIMEOUT


def test_old_data_that_happen_to_show_the_goal_prove_no_arrival(rig: Rig) -> None:
    rig.arm.inject("stale")
    rig.run(0.2)

    assert rig.until_settled(rig.arm.move_cp(HOME)).code is Code.MOVE_TIMEOUT


def test_a_frozen_command_link_drops_commands_silently(rig: Rig) -> None:
    rig.arm.inject("freeze")
    move = rig.arm.move_cp(HOME.moved(AHEAD))
    rig.run(0.3)
    early = move.report().status

    assert early is MoveStatus.RUNNING and rig.arm.operating_state().ready
    assert rig.until_settled(move).code is Code.MOVE_REJECTED
    assert rig.arm.true_pose().position == pytest.approx(HOME.position, abs=1e-9)


def test_a_fault_comes_back_after_each_enable_until_it_is_cleared(rig: Rig) -> None:
    rig.arm.inject("fault")
    rig.arm.state_command("enable")
    rig.run(STEP)
    persists = rig.arm.operating_state()
    rig.arm.inject("clear")
    rig.arm.state_command("enable")
    rig.run(STEP)

    assert persists.state is OperatingState.FAULT and persists.error
    assert rig.arm.operating_state().ready and not rig.arm.operating_state().error


def test_without_power_enabling_ends_in_fault_and_the_grasp_is_kept(rig: Rig) -> None:
    rig.until_settled(rig.arm.move_jaw(0.0))
    rig.arm.inject("power_off")
    off = rig.arm.operating_state().state
    rig.arm.state_command("enable")
    rig.run(0.1)

    assert off is OperatingState.DISABLED
    assert rig.arm.operating_state().state is OperatingState.FAULT
    assert rig.arm.true_jaw() == 0.0
    assert rig.arm.faults == {"power_off"}


def test_an_unknown_fault_is_refused_with_the_known_ones(rig: Rig) -> None:
    with pytest.raises(InputError, match="power_off"):
        rig.arm.inject("tired")


@pytest.mark.parametrize("bad", [{"latency": -1.0}, {"free_speed": 0.0}, {"bias": (0.0, 0.0)}, {"force_noise": float("nan")}])
def test_impossible_settings_are_bad_input(bad: dict) -> None:
    with pytest.raises(InputError, match=next(iter(bad))):
        ArmConfig(**bad)
