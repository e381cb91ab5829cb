"""Runs an experiment's jobs in processes of their own, on all cores, and gives their results as they come."""

from __future__ import annotations

import logging
import os
import threading
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from multiprocessing import get_context, parent_process
from typing import TypeVar

J = TypeVar("J")
R = TypeVar("R")


def results(work: Callable[[J], R], jobs: Sequence[J], workers: int | None = None) -> Generator[R, None, None]:
    """Results of `work` on each job as they come; on an interrupt nothing new is begun and what runs is ended.

    Close it (`contextlib.closing`) where the interrupt may come between two results.
    """
    if not jobs:
        return
    # Spawned, not forked: a forked child would share the state of Warp's and OpenCV's threads.
    count = min(workers or os.cpu_count() or 1, len(jobs))
    pool = ProcessPoolExecutor(count, mp_context=get_context("spawn"), initializer=_prepare_worker)
    pending: set[Future[R]] = {pool.submit(work, job) for job in jobs}
    try:
        while pending:
            ended, pending = wait(pending, return_when=FIRST_COMPLETED)
            for future in ended:
                yield future.result()
    finally:
        for process in list(getattr(pool, "_processes", {}).values()) if pending else []:
            process.terminate()
        pool.shutdown(wait=not pending, cancel_futures=True)


def _prepare_worker() -> None:
    """One core for each worker: more threads in each would only get in each other's way."""
    import signal

    import cv2

    from supervisor.warp_start import start_warp

    threading.Thread(target=_end_with_parent, daemon=True).start()
    start_warp()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    cv2.setNumThreads(1)
    logging.disable(logging.WARNING)


def _end_with_parent() -> None:
    """End this worker when the experiment is gone, however it ended: it would go on computing for nobody."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
