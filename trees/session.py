"""The whole tree. Nothing here runs: the same function serves the session, the tests, and drawings."""

from __future__ import annotations

import py_trees
from py_trees.behaviour import Behaviour
from py_trees.composites import Selector, Sequence

from behaviours.approve import Approve
from behaviours.board import GRANTED_GOAL, Step
from behaviours.checklist import Checklist
from behaviours.goal_settled import GoalSettled
from behaviours.procedure import Procedure
from behaviours.retreat import Retreat
from behaviours.services import Services
from behaviours.session import Session
from behaviours.start_tracking import StartTracking
from behaviours.verdict import Verdict
from trees.attempts import attempts
from trees.guards import guards


def create_root(services: Services) -> Behaviour:
    """Build the tree of one session; SUCCESS means that no tissue connection is left across the goal.

    The blackboard of py_trees belongs to the process: it is cleared here, so one session runs in a process at a time. To abort,
    call `root.stop(Status.INVALID)`. After the end, `behaviours.board.read(OUTCOME)` says how it ended.
    """
    py_trees.blackboard.Blackboard.clear()
    return Session("session", services, [guards(services), procedure(services)])


def procedure(services: Services) -> Behaviour:
    """Checklist, approved goal, attempts; then the tools are lifted clear, whatever the verdict."""
    return Procedure(
        "procedure",
        services,
        [
            Checklist(Step.CHECKLIST, services),
            goal(services),
            attempts(services),
            Retreat(Step.RETREAT, services),
            Verdict(Step.VERDICT, services),
        ],
    )


def goal(services: Services) -> Behaviour:
    """Have the drawn goal approved and begin to follow it, once in a session."""
    settle = Sequence(
        "settle goal",
        memory=True,
        children=[Approve(Step.APPROVE_GOAL, services, GRANTED_GOAL), StartTracking(Step.START_TRACKING, services)],
    )
    return Selector("goal", memory=True, children=[GoalSettled("goal settled?", services), settle])
