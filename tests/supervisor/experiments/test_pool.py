"""The processes that an experiment's jobs run in."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

EXPERIMENT = """
from functools import partial
from pathlib import Path
from supervisor.experiments import pool
from tests.supervisor.experiments.test_pool import tell_and_wait

if __name__ == "__main__":
    list(pool.results(partial(tell_and_wait, Path("{folder}")), [0, 1], 2))
"""
PATIENCE = 30.0  # [s]


def tell_and_wait(folder: Path, job: int) -> None:
    (folder / f"{os.getpid()}.worker").touch()
    time.sleep(10 * PATIENCE)


def test_workers_end_with_an_experiment_that_is_killed(tmp_path):
    script = tmp_path / "experiment.py"
    script.write_text(EXPERIMENT.format(folder=tmp_path))
    root = Path(__file__).parents[3]
    experiment = subprocess.Popen([sys.executable, str(script)], cwd=root, env={**os.environ, "PYTHONPATH": str(root)})
    workers: list[int] = []
    try:
        workers = [int(path.stem) for path in wait_for(lambda: [*tmp_path.glob("*.worker")], 2)]
        experiment.send_signal(signal.SIGKILL)
        experiment.wait()

        wait_for(lambda: [pid for pid in workers if not runs(pid)], 2)
    finally:
        experiment.kill()
        for pid in filter(runs, workers):
            os.kill(pid, signal.SIGKILL)


def wait_for(found, count):
    """What `found` gives, once there are `count` of it."""
    until = time.monotonic() + PATIENCE
    while len(things := found()) < count:
        assert time.monotonic() < until, f"only {len(things)} of {count} in {PATIENCE:.0f} s"
        time.sleep(0.1)
    return things


def runs(pid: int) -> bool:
    """Whether the process is there and no zombie."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
    except FileNotFoundError:
        return False
    return state != "Z"
