"""Names of nodes that stay the same from run to run; py_trees gives random ids, records and views need lasting ones."""

from __future__ import annotations

from py_trees.behaviour import Behaviour

from behaviours.board import slug


def stable_paths(root: Behaviour) -> dict[Behaviour, str]:
    """Give the path from the root of every node, in tree order: `session/guards/emergency_stop`.

    Raises:
        ValueError: two nodes have the same path.
    """
    paths: dict[Behaviour, str] = {}
    stack = [(root, slug(root.name))]
    while stack:
        node, path = stack.pop()
        paths[node] = path
        stack += [(child, f"{path}/{slug(child.name)}") for child in reversed(node.children)]
    if len(set(paths.values())) != len(paths):
        twice = sorted({path for path in paths.values() if list(paths.values()).count(path) > 1})
        raise ValueError(f"these paths name more than one node: {', '.join(twice)}")
    return paths
