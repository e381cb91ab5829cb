"""The doctor: findings, never exceptions."""

from __future__ import annotations

import importlib.metadata
import io
import json
from pathlib import Path

import pytest
from rich.console import Console

from skills.expose.xpbd import choose_device
from supervisor.doctor import Check, able, diagnose, table
from supervisor.plain import plain


def test_this_machine_can_run_the_stub_bench(tmp_path: Path) -> None:
    checks = diagnose(tmp_path)
    assert able(checks), [check for check in checks if check.required and not check.ok]
    assert {"Python", "warp-lang", "optical flow", "disk space", "ROS"} <= {check.name for check in checks}


def test_the_device_that_would_plan_the_exposure_is_named(tmp_path: Path) -> None:
    check = next(check for check in diagnose(tmp_path) if check.name == "exposure planning")
    assert check.ok and check.detail.startswith(f"on {choose_device('auto')} (")


def test_what_fails_names_a_remedy(tmp_path: Path) -> None:
    assert all(check.remedy for check in diagnose(tmp_path) if not check.ok)


def test_a_missing_package_is_a_finding_with_its_remedy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    original = importlib.metadata.version

    def version(name: str) -> str:
        if name == "mcap":
            raise importlib.metadata.PackageNotFoundError(name)
        return original(name)

    monkeypatch.setattr("supervisor.doctor.importlib.metadata.version", version)
    checks = diagnose(tmp_path)
    missing = next(check for check in checks if check.name == "mcap")
    assert (missing.ok, missing.remedy) == (False, "pip install mcap.")
    assert not able(checks)


def test_a_check_that_breaks_is_a_finding(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken() -> Check:
        raise RuntimeError("no such library")

    monkeypatch.setattr("supervisor.doctor._flow", broken)
    check = next(check for check in diagnose(tmp_path) if check.name == "optical flow")
    assert not check.ok and "no such library" in check.detail


def test_a_record_folder_below_a_file_is_not_writable(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    check = next(check for check in diagnose(tmp_path / "file" / "records") if check.name == "record folder")
    assert not check.ok


def test_the_findings_are_shown_and_are_plain_data(tmp_path: Path) -> None:
    checks = diagnose(tmp_path)
    out = io.StringIO()
    Console(file=out, width=160).print(table(checks))
    assert all(check.name in out.getvalue() for check in checks)
    assert json.loads(json.dumps(plain(checks)))[0]["name"] == "Python"
