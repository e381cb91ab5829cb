from __future__ import annotations

import py_trees
import pytest

from tests.mocks.stage import Stage
from trees.paths import stable_paths
from trees.session import create_root


def test_paths_name_every_node_once_and_are_the_same_in_every_session() -> None:
    first = list(stable_paths(Stage().build(create_root)).values())
    second = list(stable_paths(Stage().build(create_root)).values())

    assert first == second and len(set(first)) == len(first) > 40
    assert first[:3] == ["session", "session/guards", "session/guards/emergency_stop"]
    assert "session/procedure/attempts/attempt/look/expose_and_estimate/estimate" in first


@pytest.mark.parametrize("feedback", [True, False])
def test_names_are_unique_in_the_whole_tree(feedback: bool) -> None:
    names = [node.name for node in Stage(feedback=feedback).build(create_root).iterate()]

    assert len(set(names)) == len(names)


def test_two_nodes_with_one_path_are_refused() -> None:
    children = [py_trees.behaviours.Success("same"), py_trees.behaviours.Success("same")]
    root = py_trees.composites.Sequence("root", memory=True, children=children)

    with pytest.raises(ValueError, match="root/same"):
        stable_paths(root)


def test_every_leaf_says_what_it_does() -> None:
    stage = Stage()
    stage.build(create_root)
    stage.tick(100)

    silent = [
        node.name
        for node in stage.root.iterate()
        if not node.children and node.status is py_trees.common.Status.SUCCESS and not node.feedback_message
    ]
    assert silent == []
