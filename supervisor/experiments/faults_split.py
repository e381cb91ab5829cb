"""A session is split: what happens in a copy of this process has not happened here.

A copy takes only the thread along that made it, and would wait for ever for work that it gave to another. So the session may have none.
"""

from __future__ import annotations

import multiprocessing
import threading
from collections.abc import Callable, Collection
from typing import TypeVar

T = TypeVar("T")

LONGEST = 600.0  # [s] on the wall that a branch may take


def branch(act: Callable[[], T], others: Collection[threading.Thread] = ()) -> T:
    """What `act` gives in a copy of this process. `others` are threads on which nothing in the session waits: those from before it.

    Raises:
        RuntimeError: there are more threads in this process; or the branch failed, or did not come to its end.
    """
    if more := [one.name for one in threading.enumerate() if one not in others and one is not threading.current_thread()]:
        raise RuntimeError(f"a process with other threads cannot be split: {', '.join(more)}")
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
