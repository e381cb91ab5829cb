"""Plain data: what JSON can hold, made from dataclasses, arrays, enums and numbers. Nothing personal passes."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from enum import Enum
from pathlib import PurePath
from typing import Any

import numpy as np


def plain(value: Any) -> Any:
    """Turn `value` into dicts, lists, strings, numbers, bools and None.

    Numbers that are not finite become None (JSON has no NaN); a path becomes its last part, so that no personal folder
    gets into a record; an array becomes nested lists; an enumeration its value.

    Raises:
        TypeError: a kind of object that a record cannot hold.
    """
    if isinstance(value, Enum):  # before str and int, which some enumerations also are
        return plain(value.value)
    if value is None or isinstance(value, bool | str | int):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return {str(plain(key)): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(item) for item in (sorted(value) if isinstance(value, set | frozenset) else value)]
    if isinstance(value, PurePath):
        return value.name
    raise TypeError(f"a record cannot hold a {type(value).__name__}")
