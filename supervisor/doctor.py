"""`dissect doctor`: what this machine can and cannot run, and what to do about it."""

from __future__ import annotations

import importlib
import importlib.metadata
import importlib.util
import os
import platform
import shutil
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from rich.table import Table
from rich.text import Text

PACKAGES = (
    "numpy",
    "scipy",
    "warp-lang",
    "opencv-python-headless",
    "casadi",
    "py_trees",
    "rich",
    "typer",
    "mcap",
    "rerun-sdk",
    "torch",
)
MIN_PYTHON = (3, 11)
MIN_DISK = 1e9  # [bytes]
MIN_MEMORY = 2e9  # [bytes]
GOOD, OPTIONAL, BAD = ("✓", "#2e8b57"), ("–", "#c98a1b"), ("✗", "#c8372d")


@dataclass(frozen=True)
class Check:
    """One finding. `required`: without it no session runs on the stub bench; `remedy` is empty when all is well."""

    name: str
    ok: bool
    detail: str
    remedy: str = ""
    required: bool = True


def diagnose(folder: Path = Path()) -> list[Check]:
    """Look at this machine; `folder` is where sessions would be recorded. A check that breaks is a finding, never an error."""
    checks: list[tuple[str, Callable[[], Check]]] = [
        ("Python", _python),
        *((package, _package(package)) for package in PACKAGES),
        ("Warp devices", _warp),
        ("exposure planning", _planning),
        ("kernel cache", _kernel_cache),
        ("stereo matching", _stereo),
        ("optical flow", _flow),
        ("Rerun viewer", _rerun),
        ("processor", _processor),
        ("memory", _memory),
        ("record folder", lambda: _folder(folder)),
        ("disk space", lambda: _disk(folder)),
        ("ROS", _ros),
    ]
    return [_safely(name, check) for name, check in checks]


def versions() -> dict[str, str]:
    """Give the versions of Python and of every package that is installed, for the header of a record."""
    found = {"python": platform.python_version()}
    for package in PACKAGES:
        try:
            found[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            continue
    return found


def table(checks: list[Check]) -> Table:
    """Show the findings to a person."""
    shown = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), show_header=False)
    for check in checks:
        sign, colour = GOOD if check.ok else (BAD if check.required else OPTIONAL)
        remedy = Text(check.remedy, style="dim" if check.ok else colour)
        shown.add_row(Text(sign, style=colour), Text(check.name, style="bold"), Text(check.detail), remedy)
    return shown


def able(checks: list[Check]) -> bool:
    """Whether a session can run on the stub bench here."""
    return all(check.ok for check in checks if check.required)


def _safely(name: str, check: Callable[[], Check]) -> Check:
    try:
        return check()
    except Exception as error:  # a broken package can raise anything when it is imported
        return Check(name, False, f"{type(error).__name__}: {error}", "Install the package anew: pip install --force-reinstall.")


def _python() -> Check:
    ok = sys.version_info >= MIN_PYTHON
    return Check("Python", ok, platform.python_version(), "" if ok else "Python 3.11 or newer is needed.")


def _package(name: str) -> Callable[[], Check]:
    required = name != "torch"  # the learned agent only

    def check() -> Check:
        try:
            return Check(name, True, importlib.metadata.version(name), required=required)
        except importlib.metadata.PackageNotFoundError:
            use = "" if required else " It is needed for the learned agent only."
            return Check(name, False, "not installed", f"pip install {name}.{use}", required)

    return check


def _warp() -> Check:
    import warp as wp

    from supervisor.warp_start import start_warp

    start_warp()
    gpus = [f"{device.name} ({device.total_memory / 1e9:.0f} GB)" for device in wp.get_cuda_devices()]
    remedy = "" if gpus else "No GPU, none needed: all runs on the processor."
    return Check("Warp devices", True, ", ".join(["processor", *gpus]), remedy)


def _planning() -> Check:
    import warp as wp

    from skills.expose.xpbd import choose_device
    from supervisor.warp_start import start_warp

    start_warp()
    device = choose_device("auto")
    return Check("exposure planning", True, f"on {device} ({'the processor' if device == 'cpu' else wp.get_device(device).name})")


def _kernel_cache() -> Check:
    import warp as wp

    from supervisor.warp_start import start_warp

    start_warp()
    cache = Path(str(wp.config.kernel_cache_dir))
    ok = _writable(cache)
    remedy = "" if ok else "Set WARP_CACHE_PATH to a folder you can write to."
    return Check("kernel cache", ok, "writable" if ok else "not writable", remedy)


def _stereo() -> Check:
    import cv2

    cv2.StereoSGBM.create(numDisparities=16)
    return Check("stereo matching", True, f"OpenCV {cv2.__version__} StereoSGBM")


def _flow() -> Check:
    import cv2

    cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_FAST)
    return Check("optical flow", True, f"OpenCV {cv2.__version__} DIS")


def _rerun() -> Check:
    importlib.import_module("rerun")
    program = shutil.which("rerun") or shutil.which("rerun", path=str(Path(sys.executable).parent))
    remedy = "" if program else "The viewer is not on the PATH; --view rerun still writes session.rrd."
    return Check("Rerun viewer", True, "present" if program else "library only", remedy, required=False)


def _processor() -> Check:
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    said = "1 core" if cores == 1 else f"{cores} cores"
    remedy = "" if cores >= 2 else "Two cores are wanted; expect half the speed."
    return Check("processor", cores >= 2, f"{said}, {platform.machine()}", remedy, required=False)


def _memory() -> Check:
    total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    ok = total >= MIN_MEMORY
    return Check("memory", ok, f"{total / 1e9:.1f} GB", "" if ok else f"At least {MIN_MEMORY / 1e9:.0f} GB are needed.")


def _folder(folder: Path) -> Check:
    ok = _writable(folder)
    return Check("record folder", ok, "writable" if ok else "not writable", "" if ok else "Choose another one with --record.")


def _disk(folder: Path) -> Check:
    free = shutil.disk_usage(_existing(folder)).free
    ok = free >= MIN_DISK
    remedy = "" if ok else f"At least {MIN_DISK / 1e9:.0f} GB are wanted for records."
    return Check("disk space", ok, f"{free / 1e9:.1f} GB free", remedy)


def _ros() -> Check:
    found = [name for module, name in (("rclpy", "ROS 2"), ("rospy", "ROS 1")) if importlib.util.find_spec(module)]
    distribution = os.environ.get("ROS_DISTRO", "")
    detail = " and ".join(found) + (f" {distribution}" if distribution else "") if found else "not found"
    remedy = "" if found else "Needed for --bench dvrk only: source its setup file first."
    return Check("ROS", bool(found), detail, remedy, required=False)


def _existing(folder: Path) -> Path:
    """Give `folder` or the nearest folder above it that exists."""
    folder = folder.resolve()
    return next(path for path in (folder, *folder.parents) if path.exists())


def _writable(folder: Path) -> bool:
    """Whether a file can really be made there; asking for permission bits is not enough on a full or read-only disk."""
    try:
        with tempfile.TemporaryFile(dir=_existing(folder)) as file:
            file.write(b"x")
        return True
    except OSError:
        return False
