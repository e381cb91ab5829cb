"""The view in Rerun: a file that Rerun opens, a server that only this machine reaches."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from supervisor.tree_layout import tidy
from supervisor.view_rerun import RRD_FILE, RerunView
from tests.supervisor.sessions import snapshots

RERUN = Path(sys.executable).parent / "rerun"


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("rerun")
    view = RerunView(folder)
    for snapshot in snapshots():
        view.update(snapshot)
    view.mesh(np.eye(3), np.array([[0, 1, 2]]))
    view.close()
    view.close()
    return folder


@pytest.mark.skipif(not RERUN.exists(), reason="the viewer's program is not beside this Python")
def test_the_file_is_one_that_rerun_opens(folder: Path, tmp_path: Path) -> None:
    environment = {**os.environ, "HOME": str(tmp_path), "XDG_CONFIG_HOME": str(tmp_path)}
    command = [str(RERUN), "rrd", "print", str(folder / RRD_FILE)]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 0, done.stderr
    image, bench = ("endoscope/goal", "endoscope/grasp", "endoscope/edges"), ("bench/PSM1", "bench/tissue")
    exposure = [f"bench/exposure/{name}" for name in ("expected", "paths", "plan")]
    signals = [
        f"signals/{name}" for name in ("tension", "tension/expected", "losses/camera", "losses/deform", "opening", "separation")
    ]
    for entity in ("states/011", "tree", "log/gate", *image, *bench, *exposure, *signals):
        assert entity in done.stdout, entity


class Logged:
    """Stands in for a recording stream and keeps what was logged, by entity."""

    def __init__(self) -> None:
        self.entities: dict[str, list[object]] = {}

    def log(self, entity: str, *what: object, **_: object) -> None:
        self.entities.setdefault(entity, []).extend(what)

    def __getattr__(self, name: str) -> object:
        return lambda *_, **__: None


def test_what_the_controller_expects_is_shown_while_it_pulls_and_cleared_after(tmp_path: Path) -> None:
    view, logged = RerunView(tmp_path), Logged()
    view.close()
    view._open, view._stream = True, logged  # type: ignore[assignment]
    for snapshot in snapshots(images=False):
        view.update(snapshot)
    assert [len(logged.entities[f"bench/exposure/{name}"]) for name in ("expected", "paths", "plan")] == [18, 18, 18]
    wires, paths = (logged.entities[f"bench/exposure/{name}"][0] for name in ("expected", "paths"))
    # Two triangles with a common side have five sides.
    assert len(wires.strips) == 5 and len(paths.strips) == 16  # type: ignore[attr-defined]
    assert len(logged.entities["bench/exposure"]) == 2


def test_the_server_listens_on_the_loopback_interface_only(tmp_path: Path) -> None:
    port = free_port()
    view = RerunView(tmp_path, serve=True, port=port)
    try:
        view.update(next(iter(snapshots())))
        listening = [
            line.split()[1]
            for table in ("/proc/net/tcp", "/proc/net/tcp6")
            for line in (Path(table).read_text().splitlines()[1:] if Path(table).exists() else [])
            if line.split()[3] == "0A" and line.split()[1].endswith(f":{port:04X}")
        ]
        assert listening == [f"0100007F:{port:04X}"]
        assert f"127.0.0.1:{port}" in view.how_to_open and "0.0.0.0" not in view.how_to_open
    finally:
        view.close()


def test_rows_follow_the_tree_order_and_columns_the_depth() -> None:
    nodes = next(iter(snapshots(images=False))).nodes
    places = tidy(nodes)
    assert places["session"] == (0.0, 0.0)
    assert places["session/procedure/attempts/dissect"][0] == 3.0
    assert len(set(places.values())) == len(nodes)
