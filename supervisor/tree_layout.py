"""Where to draw the nodes of a tree: depth to the right and one row a node, in tree order, so that nothing overlaps."""

from __future__ import annotations

from collections.abc import Sequence

from supervisor.snapshot import NodeState


def tidy(nodes: Sequence[NodeState]) -> dict[str, tuple[float, float]]:
    """Give `(column, row)` of each node by path, `nodes` in tree order: an indented list, whose columns are depths."""
    return {node.path: (float(node.depth), float(row)) for row, node in enumerate(nodes)}
