"""The colours of every view: one for each status of a node and each state of an edge."""

STATUS = {"RUNNING": "#3a86d4", "SUCCESS": "#2e8b57", "FAILURE": "#c8372d", "INVALID": "#9aa0a6"}
STATUS_SIGN = {"RUNNING": "▶", "SUCCESS": "✓", "FAILURE": "✗", "INVALID": "·"}
CONNECTED, SEVERED, UNKNOWN = "#35c46a", "#ff4b3e", "#b9bec4"
EDGE = (CONNECTED, SEVERED, UNKNOWN)  # by EdgeState
GOAL = "#ffd23f"
GRASP = "#4fc3f7"


def rgb(colour: str) -> tuple[int, int, int]:
    """Red, green and blue (0..255) of `#rrggbb`."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)
