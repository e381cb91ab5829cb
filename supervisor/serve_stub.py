"""`dissect serve-stub`: the stub bench as a da Vinci research kit on a ROS graph, in real time, until interrupted."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from hardware.codes import InputError
from hardware.dvrk.choose_transport import make_transport
from hardware.dvrk.transport import Clock, TransportError
from hardware.served.node import ServedBench, Serving
from hardware.served.site import ROBOT, write_site
from hardware.stub.bench import STEP, StubBench
from hardware.stub.scene import Scene

NODE = "dvrk_stub"
LATE = 0.25  # [s] behind real time, from which on time is given up instead of made up for


@dataclass(frozen=True)
class ServeOptions:
    """What to serve: `folder` is where robot.toml and the hand-eye files go, `pictures` how many pairs of images per second."""

    scene: Scene
    seed: int
    folder: Path
    transport: str = "ros1"
    prefix: str = ""
    pictures: float = 10.0


def serve(options: ServeOptions, ready: Callable[[Path], None]) -> None:
    """Serve until KeyboardInterrupt; `ready` is told the configuration file once all topics are there.

    Raises:
        InputError: the prefix is no namespace, there is no ROS, or its master does not answer.
    """
    try:
        transport = make_transport(options.transport, NODE)
    except TransportError as error:
        raise InputError(str(error)) from error
    try:
        bench = StubBench(options.scene, options.seed)
        config = write_site(bench, options.folder, options.transport, options.prefix)
        served = ServedBench(bench, transport, config, Serving(pictures=options.pictures, threaded=True))
        ready(options.folder / ROBOT)
        try:
            keep_time(served, time.monotonic, time.sleep)
        except KeyboardInterrupt:
            pass
        finally:
            served.close()
    finally:
        transport.close()


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
