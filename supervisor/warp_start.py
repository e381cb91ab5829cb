"""Starts Warp without its note that there is no GPU: none is needed, and it would be the first thing a user reads."""

import os
import sys

import warp as wp


def start_warp() -> None:
    """Initialise Warp; what its native library writes to standard error meanwhile is dropped, its exceptions are not."""
    wp.config.log_level = wp.LOG_WARNING
    sys.stderr.flush()
    kept = os.dup(2)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        wp.init()
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)
