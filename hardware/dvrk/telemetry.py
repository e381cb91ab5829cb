"""The newest reading of each topic, and how good it is: valid, fresh, alive, and as frequent as it should be.

Data are always published, valid or not: a stamp of 0 means that the robot itself calls them invalid. Stamps are by the robot's clock, which
may be hours from ours, so a reading's age is told by when it was received; of the stamp only its progress counts. The least delay
ever seen between stamp and receipt is taken for the clocks' offset; what comes later than that is as much older. A clock that is
set in the middle of a session tells no ages any more: set back it makes all data look late, set ahead it makes them invalid, and the
arms hold. Callbacks may come from any thread.
"""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from hardware.dvrk.messages import JointState, Message, PoseStamped, WrenchStamped
from hardware.dvrk.transport import Subscription, Transport
from hardware.interface import Array

M = TypeVar("M", bound=Message)

DRIFT = 1e-3  # [s/s] by which the offset may grow: clocks drift apart, and a link's least delay may
UNIT = 1e-3  # how far a quaternion's length may lie from 1
SET_BACK = 1.0  # [s]; a stamp further behind the last one than this comes from a clock that was set
SET_AHEAD = 1.0  # [s]; nor does a message come this much sooner than the soonest of all before
SOME = 20  # gaps between messages that are looked at together
KEPT = 2000  # readings that the figures are told from
WATCHED = 40  # readings by which noise is known
REPEATED = 0.1  # share of a noisy sensor's readings that may equal the one before


@dataclass(frozen=True)
class Received(Generic[M]):
    """A message received at `received` [s] of bench time; `taken` [s] is when it was measured, as far as can be told."""

    message: M
    received: float
    taken: float


@dataclass(frozen=True)
class Sample(Generic[M]):
    """The newest good message of a topic, what was wrong with the newest one ("" nothing), and since when its values stand still.

    `noisy`: before they stood still they never did, not even where nothing moved, as those of a live encoder or current sensor.
    """

    good: Received[M] | None
    problem: str
    unchanged_since: float
    noisy: bool = False

    def fresh(self, now: float, limit: float) -> bool:
        """Whether it is valid and at most `limit` [s] old at `now` [s]."""
        return self.good is not None and not self.problem and now - self.good.taken <= limit


@dataclass(frozen=True)
class TopicFigures:
    """How a periodic topic came in: rate [Hz], delays beyond the least one [s], longest silence [s], and how many were lost or invalid."""

    topic: str
    received: int
    rate: float
    delay_median: float
    delay_p99: float
    longest_gap: float
    dropped: int
    invalid: int


class Stream(Generic[M]):
    """One periodic topic with stamps. `problem` says why a message cannot be used, "" when it can."""

    def __init__(
        self, transport: Transport, topic: str, kind: type[M], epoch: float, problem: Callable[[M], str] = lambda message: ""
    ) -> None:
        self.topic, self._epoch, self._problem = topic, epoch, problem
        self._lock = threading.Lock()
        self._good: Received[M] | None = None
        self._wrong = ""
        self._unchanged_since = math.inf
        self._noise = _Noise()
        self._offset = math.inf
        self._first = self._last = math.nan
        self._count = self._invalid = 0
        self._longest = 0.0
        self._delays: deque[float] = deque(maxlen=KEPT)
        self._gaps: deque[float] = deque(maxlen=KEPT)
        self._subscription: Subscription = transport.subscribe(topic, kind, self._take)

    def sample(self) -> Sample[M]:
        """The newest reading."""
        with self._lock:
            return Sample(self._good, self._wrong, self._unchanged_since, self._noise.known)

    def sources(self) -> int:
        """How many publishers are connected."""
        return self._subscription.sources()

    def figures(self) -> TopicFigures:
        """How the topic came in so far."""
        with self._lock:
            time = self._last - self._first
            period = _period(self._gaps)
            dropped = max(0, round(time / period) + 1 - self._count) if period > 0 else 0
            delays = np.array(self._delays) if self._delays else np.array([math.nan])
            return TopicFigures(
                self.topic,
                self._count,
                (self._count - 1) / time if time > 0 else 0.0,
                float(np.median(delays)),
                float(np.percentile(delays, 99)),
                self._longest,
                dropped,
                self._invalid,
            )

    def _take(self, message: M, received: float) -> None:
        now = received - self._epoch
        with self._lock:
            self._count_in(now)
            stamp = float(getattr(message, "stamp", math.nan))
            self._wrong = self._stamp_problem(stamp, now) or self._problem(message)
            if self._wrong:
                self._invalid += 1
                return
            last = self._good
            if last is not None and 0.0 <= float(getattr(last.message, "stamp", math.nan)) - stamp < SET_BACK:
                return  # a repetition is no news; from further back, the robot's clock was set, and its data count as late
            drift = DRIFT * (now - last.received) if last else 0.0
            self._offset = min(self._offset + drift, now - stamp)
            taken = stamp + self._offset
            self._delays.append(now - taken)
            if self._noise.changed(message):
                self._unchanged_since = now
            self._good = Received(message, now, taken)

    def _stamp_problem(self, stamp: float, now: float) -> str:
        if stamp == 0.0:
            return "the robot calls its data invalid (stamp 0)"
        if not math.isfinite(stamp):
            return "its stamp is not finite"
        ahead = self._offset - (now - stamp)
        known = len(self._delays) >= SOME  # the first messages may have waited for long
        return f"the clock of its stamps was set ahead by {ahead:.1f} s" if known and ahead > SET_AHEAD else ""

    def _count_in(self, now: float) -> None:
        self._count += 1
        if math.isnan(self._first):
            self._first = now
        else:
            self._gaps.append(now - self._last)
            self._longest = max(self._longest, now - self._last)
        self._last = now


class _Noise:
    """Whether a topic's numbers change, and whether they do so by noise: a motion without it goes on, and then stands still for good."""

    def __init__(self) -> None:
        self.known = False
        self._last: Array | None = None
        self._step: Array | None = None
        self._changes: deque[bool] = deque(maxlen=WATCHED)
        self._turns: deque[bool] = deque(maxlen=WATCHED)  # whether a change went back on the one before

    def changed(self, message: Message) -> bool:
        """Take the next message; gives whether it tells other numbers than the last one."""
        numbers, last = _numbers(message), self._last
        self._last = numbers
        if numbers is None or last is None or numbers.shape != last.shape:
            self._step = None
            return True
        if np.array_equal(numbers, last):
            self._changes.append(False)
            return False
        step = numbers - last
        if self._step is not None:
            self._turns.append(float(step @ self._step) < 0.0)
        self._step = step
        self._changes.append(True)
        # Known by what came before, and so told as long as the numbers stand still.
        enough = len(self._turns) == WATCHED == len(self._changes)
        self.known = enough and self._changes.count(False) <= REPEATED * WATCHED and 2 * sum(self._turns) >= WATCHED
        return True


class Event(Generic[M]):
    """One topic that speaks only when something happens. Latched, its first message may be old: who cares asks when it was received."""

    def __init__(self, transport: Transport, topic: str, kind: type[M], epoch: float, latched: bool = True) -> None:
        self.topic, self._epoch = topic, epoch
        self._newest: Received[M] | None = None
        self._subscription = transport.subscribe(topic, kind, self._take, latched=latched, queue=10)

    def newest(self) -> Received[M] | None:
        """The newest message; None before the first."""
        return self._newest

    def since(self, stamp: float) -> M | None:
        """The newest message if it was received at `stamp` [s] or later."""
        newest = self._newest
        return newest.message if newest is not None and newest.received >= stamp else None

    def sources(self) -> int:
        """How many publishers are connected."""
        return self._subscription.sources()

    def _take(self, message: M, received: float) -> None:
        self._newest = Received(message, received - self._epoch, received - self._epoch)


# ------------------------------------------------------------ what may be wrong with a message


def pose_problem(message: PoseStamped) -> str:
    """Why this is no pose: numbers that are not finite, or no unit quaternion."""
    numbers = np.concatenate([np.ravel(message.position), np.ravel(message.quaternion)])
    if numbers.shape != (7,) or not np.isfinite(numbers).all():
        return "its pose holds numbers that are missing or not finite"
    length = float(np.linalg.norm(message.quaternion))
    return "" if abs(length - 1.0) <= UNIT else f"its quaternion has length {length:.3f} instead of 1"


def joints_problem(count: int) -> Callable[[JointState], str]:
    """Why this is no reading of `count` joints. Without a tool a manipulator reports 7 actuators instead of 6 joints."""

    def problem(message: JointState) -> str:
        if len(message.position) != count:
            return f"it reports {len(message.position)} joints instead of {count}"
        return "" if np.isfinite(message.position).all() else "its joint positions are not finite"

    return problem


def wrench_problem(message: WrenchStamped) -> str:
    """Why this is no force."""
    return "" if np.shape(message.force) == (3,) and np.isfinite(message.force).all() else "its force is not finite"


def _numbers(message: Message) -> Array | None:
    """What a live encoder or current sensor tells, as one vector; None for what is no such reading."""
    if isinstance(message, JointState):
        return np.concatenate([np.ravel(getattr(message, name)) for name in ("position", "velocity", "effort")])
    if isinstance(message, PoseStamped):
        return np.concatenate([np.ravel(message.position), np.ravel(message.quaternion)])
    return None


def _period(gaps: Sequence[float]) -> float:
    """How far apart messages are meant to come [s]: the usual mean over a few, as a sender's own steps make single gaps uneven."""
    whole = len(gaps) // SOME * SOME
    if whole == 0:
        return float(np.median(gaps)) if gaps else math.nan
    return float(np.median(np.array(gaps)[-whole:].reshape(-1, SOME).mean(axis=1)))
