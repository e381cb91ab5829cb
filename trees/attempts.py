"""The attempts: dissect, expose, estimate, and replan until nothing crosses the goal or the attempts are used up."""

from __future__ import annotations

from py_trees.behaviour import Behaviour
from py_trees.common import ParallelPolicy
from py_trees.composites import Parallel, Selector, Sequence

from behaviours.approve import Approve
from behaviours.attempts import Attempts
from behaviours.attempts_left import AttemptsLeft
from behaviours.begin_attempt import BeginAttempt
from behaviours.board import GRANTED_AGAIN, GRANTED_CORRECTIVE, GRANTS, Step
from behaviours.complete import Complete
from behaviours.dissect import Dissect
from behaviours.estimate import EstimateConnectivity
from behaviours.expose import Expose
from behaviours.look_again import LookAgain
from behaviours.look_anyway import LookAnyway
from behaviours.look_first import LookFirst
from behaviours.permitted import Permitted
from behaviours.replan import Replan
from behaviours.services import Services
from behaviours.track import Track


def attempts(services: Services) -> Behaviour:
    """Up to `max_attempts`. Without feedback an attempt is a dissection and nothing else."""
    if not services.feedback:
        steps = [BeginAttempt(Step.BEGIN_ATTEMPT, services), cut_goal(services)]
    else:
        steps = [BeginAttempt(Step.BEGIN_ATTEMPT, services), cut(services), look(services), judge(services)]
    return Attempts("attempts", services, Sequence("attempt", memory=True, children=steps))


def cut(services: Services) -> Behaviour:
    """Cut, unless the attempt was resumed after an interruption and must look first."""
    return Selector("cut", memory=True, children=[LookFirst("look first?", services), cut_goal(services)])


def cut_goal(services: Services) -> Behaviour:
    """Dissect with a permission that fits the scene; after a failure go on if looking helps."""
    again = Approve(Step.APPROVE_AGAIN, services, GRANTED_AGAIN)
    permission = Selector(
        "permission",
        memory=True,
        children=[
            Permitted("permitted?", services, GRANTS),
            beside(again, Track(Step.TRACK_WHILE_ASKING, services), "approve again and track"),
        ],
    )
    dissect = beside(Dissect(Step.DISSECT, services), Track(Step.TRACK_DISSECT, services), "dissect and track")
    dissection = Selector("dissection", memory=True, children=[dissect, LookAnyway("look anyway?", services)])
    return Sequence("cut goal", memory=True, children=[permission, dissection])


def look(services: Services) -> Behaviour:
    """Expose and estimate, once more where one look was not enough."""
    expose = beside(Expose(Step.EXPOSE, services), Track(Step.TRACK_EXPOSE, services), "expose and track")
    estimate = EstimateConnectivity(Step.ESTIMATE, services)
    return LookAgain("look", services, Sequence("expose and estimate", memory=True, children=[expose, estimate]))


def judge(services: Services) -> Behaviour:
    """Complete? Else plan and have approved what the next attempt cuts, if there is one."""
    approve = Approve(Step.APPROVE_CORRECTIVE, services, GRANTED_CORRECTIVE)
    next_goal = Sequence(
        "next goal",
        memory=True,
        children=[
            AttemptsLeft(Step.ATTEMPTS_LEFT, services),
            Replan(Step.REPLAN, services),
            beside(approve, Track(Step.TRACK_WHILE_CORRECTING, services), "approve corrective goal and track"),
        ],
    )
    return Selector("judge", memory=True, children=[Complete("complete?", services), next_goal])


def beside(work: Behaviour, track: Track, name: str) -> Behaviour:
    """`work` with `track` beside it; tracking comes first in each tick, so that `work` sees the newest picture."""
    return Parallel(name, policy=ParallelPolicy.SuccessOnSelected([work]), children=[track, work])
