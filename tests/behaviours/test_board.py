from __future__ import annotations

from typing import Any

import pytest

from behaviours.board import ATTEMPT, LOOKED_AGAIN, Attempt, Board, read
from behaviours.services import Services
from hardware.codes import InputError
from tests.mocks.stage import Stage
from trees.session import create_root


def test_a_key_has_its_default_before_the_first_write() -> None:
    Stage()
    board = Board("a leaf", reads=(ATTEMPT,))

    assert board.get(ATTEMPT) == Attempt() == read(ATTEMPT)


def test_what_one_writes_the_other_reads() -> None:
    Stage()
    writer, reader = Board("writer", writes=(ATTEMPT,)), Board("reader", reads=(ATTEMPT,))

    writer.set(ATTEMPT, Attempt(2, False, 1))

    assert reader.get(ATTEMPT) == writer.get(ATTEMPT) == Attempt(2, False, 1)


def test_a_key_has_one_writer() -> None:
    Stage()
    first = Board("first", writes=(ATTEMPT,))

    with pytest.raises(AttributeError, match="exclusive"):
        Board("second", writes=(ATTEMPT,))
    assert first.get(ATTEMPT) == Attempt()


def test_a_key_that_was_not_declared_cannot_be_read_or_written() -> None:
    Stage()
    board = Board("a leaf", reads=(ATTEMPT,))

    with pytest.raises(AttributeError):
        board.get(LOOKED_AGAIN)
    with pytest.raises(AttributeError):
        board.set(ATTEMPT, Attempt())


def test_a_second_session_in_the_process_starts_with_an_empty_blackboard() -> None:
    stage = Stage()
    stage.build(create_root)
    stage.tick(10)
    assert read(ATTEMPT).number == 1

    stage.build(create_root)

    assert read(ATTEMPT).number == 0


@pytest.mark.parametrize("setting", [{"max_attempts": 0}, {"approval_lifetime": float("nan")}, {"max_displacement": -1.0}])
def test_settings_out_of_range_are_refused_in_one_sentence(setting: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=f"{next(iter(setting))} is .*; it must be"):
        Stage(**setting)
    assert Services.max_attempts == 3
