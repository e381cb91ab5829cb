"""Properties of the safety gate over random sequences of commands and events."""

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from hardware.interface import CUTTER, GRASPER, OperatingState, Pose
from hardware.motion_checks import segment_distance
from tests.mocks.table import TICK, Table

numbers = st.one_of(st.floats(-3, 3), st.floats(-100, 100), st.sampled_from([math.nan, math.inf, 0.0]))
acts = st.lists(
    st.one_of(
        st.tuples(st.just("servo_cp"), st.sampled_from([GRASPER, CUTTER]), st.tuples(numbers, numbers, numbers)),
        st.tuples(st.just("move_cp"), st.sampled_from([GRASPER, CUTTER]), st.tuples(numbers, numbers, numbers)),
        st.tuples(st.just("move_jaw"), st.sampled_from([GRASPER, CUTTER]), st.tuples(numbers)),
        st.tuples(st.just("advance"), st.just(""), st.tuples(st.sampled_from([0.01, TICK, 0.2]))),
        st.tuples(st.just("hold"), st.just(""), st.just(())),
        st.tuples(st.just("revoke"), st.just(""), st.just(())),
        st.tuples(st.just("approve"), st.just(""), st.just(())),
        st.tuples(st.just("force"), st.just(""), st.tuples(st.floats(0, 7))),
        st.tuples(st.just("fault"), st.sampled_from([GRASPER, CUTTER]), st.just(())),
    ),
    max_size=25,
)


@settings(max_examples=150, deadline=None)
@given(acts)
def test_whatever_is_commanded_what_reaches_an_arm_is_within_all_limits(sequence: list[tuple[str, str, tuple]]) -> None:
    table = Table()
    bench, limits = table.bench, table.gate.limits
    low, high = np.array(limits.workspace_lower), np.array(limits.workspace_upper)
    for act, arm, values in sequence:
        before = {name: device.setpoint_cp() for name, device in bench.arms.items()}
        jaw, approved = bench.cutter.jaw, table.gate.approval is not None
        fit = table.lease.alive and table.gate.tripped is None
        logged = len(bench.motions())
        if act in ("servo_cp", "move_cp"):
            target = before[arm].moved(np.array(values) * 1e-3)
            getattr(table.lease, act)(arm, target)
        elif act == "move_jaw":
            table.lease.move_jaw(arm, values[0])
        elif act == "advance":
            bench.advance(values[0])
        elif act == "hold":
            table.lease.hold()
        elif act == "revoke":
            table.gate.revoke(table.lease)
        elif act == "approve":
            table.approve(0.1)
        elif act == "force":
            bench.grasper.force = np.array([0.0, values[0], 0.0])
        elif act == "fault":
            bench.arms[arm].fault()

        for command in bench.motions()[logged:]:
            assert fit
            assert bench.arms[command.arm].operating_state().state is OperatingState.ENABLED
            if isinstance(command.target, Pose):
                assert command.target.is_finite()
                assert (command.target.position >= low).all() and (command.target.position <= high).all()
                step = np.linalg.norm(command.target.position - before[command.arm].position)
                assert command.name == "move_cp" or step <= limits.max_step + 1e-5
            else:
                assert isinstance(command.target, float) and math.isfinite(command.target)
                assert command.arm == GRASPER or command.target >= jaw - 0.03 or approved
        if not table.lease.alive:
            assert bench.holding()


@settings(max_examples=50, deadline=None)
@given(acts)
def test_after_a_revocation_no_command_reaches_an_arm(sequence: list[tuple[str, str, tuple]]) -> None:
    table = Table()
    table.approve()
    table.gate.revoke(table.lease)
    logged = len(table.bench.log)

    for act, arm, values in sequence:
        if act in ("servo_cp", "move_cp"):
            getattr(table.lease, act)(arm, table.lease.setpoint_cp(arm).moved(np.array(values) * 1e-5))
        elif act == "move_jaw":
            table.lease.move_jaw(arm, values[0])
        else:
            table.lease.hold()

    assert len(table.bench.log) == logged


@given(st.lists(st.floats(-1, 1), min_size=12, max_size=12))
def test_segment_distance_agrees_with_dense_sampling(numbers: list[float]) -> None:
    a, b, c, d = np.array(numbers).reshape(4, 3)
    s = np.linspace(0, 1, 60)[:, None]
    sampled = np.linalg.norm((a + s * (b - a))[:, None] - (c + s * (d - c))[None], axis=-1).min()

    exact = segment_distance(a, b, c, d)

    assert exact <= sampled + 1e-9
    assert sampled <= exact + 0.1
