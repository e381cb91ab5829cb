"""docs/dvrk.md says what each refusal means: no sentence of the guards, the driver or the gate is left out of it."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[3]
PAGE = ROOT / "docs" / "dvrk.md"
FILES = [
    *(ROOT / "hardware" / "dvrk").glob("*.py"),
    *(ROOT / "hardware" / name for name in ("gate.py", "grasp_load.py", "motion_checks.py", "readings.py")),
]
REFUSALS = {"_wait", "_end", "Refusal", "InputError", "TransportError", "trip"}
TO_PROGRAMMERS = {"local.py", "transport.py", "ros1.py", "ros2.py", "ros_messages.py", "kinematics.py", "messages.py"}


def words(text: str) -> str:
    return " ".join(re.findall(r"[a-z]{2,}", text.lower()))


def fragments(message: ast.expr) -> list[str]:
    """What is always the same in a sentence."""
    if isinstance(message, ast.JoinedStr):
        return [str(part.value) for part in message.values if isinstance(part, ast.Constant)]
    return [message.value] if isinstance(message, ast.Constant) and isinstance(message.value, str) else []


def sentences() -> Iterator[tuple[str, str]]:
    """Each constant part of a refusal with three words or more, and where it stands."""
    for file in FILES:
        if file.name in TO_PROGRAMMERS:
            continue
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and getattr(node.func, "id", getattr(node.func, "attr", "")) in REFUSALS:
                for part in (part for argument in node.args for part in fragments(argument)):
                    if len(words(part).split()) >= 3:
                        yield words(part), f"{file.name}:{node.lineno}"


def test_the_page_explains_every_refusal():
    page = words(PAGE.read_text(encoding="utf-8"))
    said = list(sentences())

    assert len(said) > 80
    assert [(part, where) for part, where in said if part not in page] == []
