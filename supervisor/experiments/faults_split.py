"""A session is split: what happens in a copy of this process has not happened here.

A copy takes only the thread along that made it, and would wait for ever for work that it gave to another. So none may be there.
"""

from __future__ import annotations

import multiprocessing
import threading
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")

LONGEST = 600.0  # [s] on the wall that a branch may take


def branch(act: Callable[[], T]) -> T:
    """What `act` gives in a copy of this process.

    Raises:
        RuntimeError: there are other threads in this process; or the branch failed, or did not come to its end.
    """
    if others := [one.name for one in threading.enumerate() if one is not threading.current_thread()]:
        raise RuntimeError(f"a process with other threads cannot be split: {', '.join(others)}")
    context = multiprocessing.get_context("fork")
    receive, send = context.Pipe(duplex=False)
    process = context.Process(target=lambda: send.send(act()))
    process.start()
    send.close()
    try:
        if not receive.poll(LONGEST):
            raise RuntimeError(f"a branch of the session did not come to its end within {LONGEST:.0f} s")
        found: T = receive.recv()
    except EOFError as error:
        raise RuntimeError("a branch of the session failed; its traceback is above") from error
    finally:
        if process.is_alive() and not receive.poll():
            process.join(1.0)
        if process.is_alive():
            process.kill()
        process.join()
        receive.close()
    return found
