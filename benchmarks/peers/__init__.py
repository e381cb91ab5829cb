"""Peers of the tissue simulator: other people's XPBD on the same sheet, with the same pull and the same number of projections."""

from __future__ import annotations

import importlib

EXTRA = "install the peers with: pip install -c constraints.txt -e '.[bench]'"


def missing(module: str) -> str | None:
    """Why a peer cannot be measured here, in a sentence; None if it can."""
    try:
        importlib.import_module(module)
    except ImportError as error:
        why = "is not installed" if error.name == module else f"cannot be imported ({error})"
        return f"{module} {why}; {EXTRA}"
    return None
