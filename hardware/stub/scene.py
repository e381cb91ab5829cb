"""Scenes of the simulated bench as TOML files: tissue, bed, camera, arms and the goal an expert would draw on it."""

from __future__ import annotations

import difflib
import tomllib
from dataclasses import MISSING, dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

import numpy as np

from hardware.codes import InputError
from hardware.interface import Array, CameraModel

C = TypeVar("C")
MATERIALS = ("silicone", "chicken", "beef")


@dataclass(frozen=True)
class TissueConfig:
    """The sheet. Lengths [m]."""

    material: str = "silicone"
    width: float = 0.080
    height: float = 0.060
    thickness: float = 1.5e-3
    youngs_modulus: float = 60e3  # [Pa]
    density: float = 1070.0  # [kg/m^3]
    bending: float = 2e-7  # [J], isometric bending stiffness
    puncture_force: float = (
        0.07  # [N], mean force at which a blade tip goes through (sharp dissection: hundredths to tenths of a newton)
    )
    puncture_variation: float = 0.45  # relative standard deviation of that force over the sheet
    puncture_scale: float = 6e-3  # [m], over which it varies
    tear_stretch: float = 3.0  # stretch at which tissue tears (mesentery, peritoneum, fascia: 1.8 to 3.2)
    fine_spacing: float = 0.8e-3
    coarse_spacing: float = 2.4e-3
    fine_band: float = 5e-3  # [m], half width of the finely meshed band around the goal


@dataclass(frozen=True)
class BedConfig:
    """What the sheet lies on, and how it is held there."""

    slope_deg: float = 0.0  # rotation of the whole table about the image's horizontal axis
    bump_height: float = 4e-3  # [m], the tumour
    bump_radius: float = 22e-3  # [m]
    adhesion: float = 2e6  # [N/m per m^2], outside the undermined region
    undermined_adhesion: float = 1e4  # [N/m per m^2], over the plane that was prepared under the goal
    undermined_margin: float = 12e-3  # [m], how far that plane reaches beyond the goal
    adhesion_limit: float = 2.5e-3  # [m], stretch at which an adhesion breaks in the undermined region


@dataclass(frozen=True)
class CameraConfig:
    """The stereo endoscope."""

    distance: float = 0.080  # [m], to the middle of the sheet
    tilt_deg: float = 30.0  # from the vertical
    focal: float = 620.0  # [px]
    baseline: float = 4.3e-3  # [m]
    noise: float = 2.0  # [grey levels], standard deviation


@dataclass(frozen=True)
class ArmsConfig:
    """Imperfections of both arms; each session draws its own values from the seed."""

    bias: float = 0.4e-3  # [m], standard deviation per axis of the constant calibration error left after registration
    backlash: float = 0.2e-3  # [m]
    latency: float = 0.05  # [s]
    force_noise: float = 0.05  # [N]
    grip_force: float = 4.5  # [N], load at which the grasp begins to slip
    grip_variation: float = 0.3  # [N], its standard deviation over sessions


@dataclass(frozen=True)
class GoalConfig:
    """The expert's goal in rest coordinates of the sheet [m]."""

    line: tuple[tuple[float, float], ...] = ((-0.020, 0.0), (0.020, 0.0))
    grasp: tuple[float, float] = (0.0, 0.009)


@dataclass(frozen=True)
class Scene:
    """One scene. `name` is what `--scene` says."""

    name: str
    description: str = ""
    tissue: TissueConfig = field(default_factory=TissueConfig)
    bed: BedConfig = field(default_factory=BedConfig)
    camera: CameraConfig = field(default_factory=CameraConfig)
    arms: ArmsConfig = field(default_factory=ArmsConfig)
    goal: GoalConfig = field(default_factory=GoalConfig)

    @property
    def line(self) -> Array:
        """The goal's line (M, 2) [m], rest coordinates."""
        return np.array(self.goal.line, dtype=np.float64)

    @property
    def bump(self) -> tuple[float, float, float, float]:
        """Centre x, y, radius and height [m] of the bed's bump."""
        return (0.0, 0.0, self.bed.bump_radius, self.bed.bump_height)

    def camera_model(self) -> CameraModel:
        """Intrinsics of the rectified 640 x 480 pair."""
        return CameraModel(640, 480, self.camera.focal, 319.5, 239.5, self.camera.baseline)

    def camera_from_table(self) -> tuple[Array, Array]:
        """Rotation (3, 3) and translation (3,) [m] that take points of the table frame (x right, y away, z up) to the left camera frame."""
        tilt = np.deg2rad(self.camera.tilt_deg)
        position = self.camera.distance * np.array([0.0, -np.sin(tilt), np.cos(tilt)])
        z = -position / np.linalg.norm(position)
        x = np.array([1.0, 0.0, 0.0])
        rotation = np.stack([x, np.cross(z, x), z])
        return rotation, -rotation @ position

    def gravity(self) -> Array:
        """Gravity (3,) [m/s^2] in the table frame, which tilts with the slope."""
        slope = np.deg2rad(self.bed.slope_deg)
        return 9.81 * np.array([0.0, -np.sin(slope), -np.cos(slope)])


def scene_names() -> list[str]:
    """Names of the scenes that come with the program."""
    return sorted(path.stem for path in _folder().glob("*.toml"))


def load_scene(name: str) -> Scene:
    """Load a scene by name or from a TOML file.

    Raises:
        InputError: unknown scene, unreadable file, unknown key or a value out of range; the sentence names it and what would be right.
    """
    path = Path(name)
    if path.suffix == ".toml":
        if not path.is_file():
            raise InputError(f"the scene file {name} does not exist")
    else:
        path = _folder() / f"{name}.toml"
        if not path.is_file():
            near = difflib.get_close_matches(name, scene_names(), 1)
            hint = f"did you mean {near[0]}? " if near else ""
            raise InputError(
                f"there is no scene named {name!r}; {hint}known scenes: {', '.join(scene_names())}, or give a .toml file"
            )
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"the scene file {path.name} cannot be read: {error}") from error
    table.setdefault("name", path.stem)
    scene = _from_table(Scene, table, path.name)
    _check(scene)
    return scene


def _folder() -> Path:
    return Path(__file__).parent / "scenes"


def _from_table(kind: type[C], table: dict[str, Any], where: str) -> C:
    """A frozen dataclass from a TOML table; unknown keys are errors that name the nearest known one."""
    hints = get_type_hints(kind)
    known = {f.name: f for f in fields(kind)}  # type: ignore[arg-type]
    values: dict[str, Any] = {}
    for key, value in table.items():
        if key not in known:
            near = difflib.get_close_matches(key, known, 1)
            hint = f"; did you mean {near[0]!r}?" if near else f"; known keys: {', '.join(known)}"
            raise InputError(f"unknown key {key!r} in {where}{hint}")
        values[key] = _value(hints[key], value, f"{where}: {key}")
    for name, f in known.items():
        if name not in values and f.default is MISSING and f.default_factory is MISSING:
            raise InputError(f"the key {name!r} is missing in {where}")
    return kind(**values)


def _value(hint: Any, value: Any, where: str) -> Any:
    if is_dataclass(hint):
        if not isinstance(value, dict):
            raise InputError(f"{where} must be a table of keys")
        return _from_table(hint, value, where)  # type: ignore[type-var, arg-type]
    if hint is float:
        if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
            raise InputError(f"{where} must be a finite number, not {value!r}")
        return float(value)
    if hint is str:
        if not isinstance(value, str):
            raise InputError(f"{where} must be text, not {value!r}")
        return value
    try:
        numbers = np.array(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{where} must be a list of numbers, not {value!r}") from error
    if not np.isfinite(numbers).all():
        raise InputError(f"{where} holds a number that is not finite")
    return tuple(map(tuple, numbers.tolist())) if numbers.ndim == 2 else tuple(numbers.tolist())


_RANGES: dict[str, tuple[float, float]] = {
    "tissue.width": (0.03, 0.20),
    "tissue.height": (0.03, 0.20),
    "tissue.thickness": (0.3e-3, 5e-3),
    "tissue.youngs_modulus": (5e3, 5e6),
    "tissue.density": (500.0, 2000.0),
    "tissue.bending": (1e-9, 1e-2),
    "tissue.puncture_force": (0.0, 5.0),
    "tissue.puncture_variation": (0.0, 1.0),
    "tissue.puncture_scale": (1e-3, 0.1),
    "tissue.tear_stretch": (1.2, 20.0),
    "tissue.fine_spacing": (0.4e-3, 3e-3),
    "tissue.coarse_spacing": (0.4e-3, 6e-3),
    "tissue.fine_band": (1e-3, 0.1),
    "bed.slope_deg": (-60.0, 60.0),
    "bed.bump_height": (0.0, 0.02),
    "bed.bump_radius": (5e-3, 0.1),
    "bed.adhesion": (0.0, 1e8),
    "bed.undermined_adhesion": (0.0, 1e8),
    "bed.undermined_margin": (0.0, 0.1),
    "bed.adhesion_limit": (1e-4, 0.1),
    "camera.distance": (0.045, 0.13),
    "camera.tilt_deg": (0.0, 65.0),
    "camera.focal": (300.0, 1200.0),
    "camera.baseline": (2e-3, 12e-3),
    "camera.noise": (0.0, 20.0),
    "arms.bias": (0.0, 5e-3),
    "arms.backlash": (0.0, 2e-3),
    "arms.latency": (0.0, 0.5),
    "arms.force_noise": (0.0, 1.0),
    "arms.grip_force": (0.5, 50.0),
    "arms.grip_variation": (0.0, 5.0),
}


def _check(scene: Scene) -> None:
    if scene.tissue.material not in MATERIALS:
        raise InputError(
            f"scene {scene.name}: tissue.material is {scene.tissue.material!r}; it must be one of {', '.join(MATERIALS)}"
        )
    for key, (low, high) in _RANGES.items():
        table, name = key.split(".")
        value = getattr(getattr(scene, table), name)
        if not low <= value <= high:
            raise InputError(f"scene {scene.name}: {key} is {value:g}; it must lie between {low:g} and {high:g}")
    line = scene.line
    if line.ndim != 2 or line.shape[0] < 2 or line.shape[1] != 2 or len(scene.goal.grasp) != 2:
        raise InputError(
            f"scene {scene.name}: goal.line needs at least two points [x, y] and goal.grasp one point [x, y], in metres"
        )
    half = np.array([scene.tissue.width, scene.tissue.height]) / 2
    for point in (*line, np.array(scene.goal.grasp)):
        if (np.abs(point) > half).any():
            raise InputError(
                f"scene {scene.name}: the goal's point {point.tolist()} lies off the sheet, whose half size is {half.tolist()} m"
            )
