from __future__ import annotations

from py_trees.common import Status

from behaviours.board import Step, lease_of
from behaviours.lease_intact import LeaseIntact
from tests.mocks.stage import Stage, put


def guarding() -> Stage:
    stage = Stage()
    stage.build(lambda services: LeaseIntact("lease intact", services))
    return stage


def test_all_is_well_while_no_skill_runs() -> None:
    assert guarding().tick() is Status.SUCCESS


def test_all_is_well_while_the_lease_of_the_running_skill_lives() -> None:
    stage = guarding()
    stage.gate.grant("expose")
    put(lease_of(Step.EXPOSE), True)

    assert stage.tick() is Status.SUCCESS


def test_a_lease_that_the_gate_took_away_interrupts() -> None:
    stage = guarding()
    stage.gate.grant("expose")
    put(lease_of(Step.EXPOSE), True)
    stage.bench.at(0.01, stage.bench.cutter.power_off)
    stage.bench.at(0.02, stage.bench.cutter.recover)

    assert stage.tick() is Status.RUNNING
    assert "took the arms away" in stage.root.feedback_message
    put(lease_of(Step.EXPOSE), False)
    assert stage.tick() is Status.SUCCESS
