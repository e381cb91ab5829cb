"""`dissect serve-stub`: the stub bench as a da Vinci research kit on a ROS graph, in real time, until interrupted.

Its folder holds all that a session needs: robot.toml, the hand-eye files and the goal that an expert would draw. In the end it holds
the truth about the tissue too, which no driver can see and nobody on the graph is told.
"""

from __future__ import annotations

import json
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from hardware.codes import InputError
from hardware.dvrk.choose_transport import make_transport
from hardware.dvrk.transport import Clock, TransportError
from hardware.served.node import ServedBench, Serving
from hardware.served.site import ROBOT, SCISSORS, write_site
from hardware.stub.bench import STEP, StubBench
from hardware.stub.scene import Scene
from skills.scene.goal import save_goal
from supervisor.experiments.evaluator import evaluate
from supervisor.robot import stay_prompt
from supervisor.stub_goal import drawn_goal

NODE = "dvrk_stub"
GOAL = "goal.json"
TRUTH = "truth.json"
LATE = 0.25  # [s] behind real time, from which on time is given up instead of made up for


@dataclass(frozen=True)
class ServeOptions:
    """What to serve: `folder` is where the files go, `pictures` how many pairs of images per second, `cutter` what PSM2 holds."""

    scene: Scene
    seed: int
    folder: Path
    transport: str = "ros1"
    prefix: str = ""
    pictures: float = 10.0
    cutter: str = SCISSORS


def serve(options: ServeOptions, ready: Callable[[Path, Path], None]) -> None:
    """Serve until KeyboardInterrupt; `ready` is told the files of configuration and goal once all topics are there.

    The last thing written, once nothing moves any more, is the truth about the tissue: truth.json.

    Raises:
        InputError: the prefix is no namespace, the instrument is not known, there is no ROS, or its master does not answer.
    """
    stay_prompt()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)  # a shell that starts it in the background leaves Ctrl-C ignored
    try:
        transport = make_transport(options.transport, NODE)
    except TransportError as error:
        raise InputError(str(error)) from error
    try:
        bench = StubBench(options.scene, options.seed)
        config = write_site(bench, options.folder, options.transport, options.prefix, options.cutter)
        save_goal(drawn_goal(bench), options.folder / GOAL)
        (options.folder / TRUTH).unlink(missing_ok=True)  # of another run
        served = ServedBench(bench, transport, config, Serving(pictures=options.pictures, threaded=True))
        ready(options.folder / ROBOT, options.folder / GOAL)
        try:
            keep_time(served, time.monotonic, time.sleep)
        except KeyboardInterrupt:
            pass
        finally:
            served.close()
            write_truth(bench, options.folder / TRUTH)
    finally:
        transport.close()


def write_truth(bench: StubBench, path: Path) -> None:
    """Write what the mesh says of the dissection now: attachments, length deviation [m], success and more."""
    truth = evaluate(bench, 0).as_dict()
    del truth["attempt"]  # the bench knows nothing of attempts
    path.write_text(json.dumps(truth, indent=1) + "\n", encoding="utf-8")


def keep_time(served: ServedBench, clock: Clock, wait: Callable[[float], None]) -> None:
    """Advance the bench as `clock` [s] does, a physics step at a time, for ever. A machine too slow makes bench time slow, not jump."""
    ahead = served.now() - clock()
    while True:
        early = served.now() - clock() - ahead
        if early < -LATE:
            ahead += early
        if early > 0.0:
            wait(early)
        served.advance(STEP)
