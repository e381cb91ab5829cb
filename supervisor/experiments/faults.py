"""Every fault of a robot in every phase of a session: what holds the arms, how soon, and how the session goes on.

python -m supervisor.experiments.faults --json faults.json --markdown docs/faults.md

One session is led to a phase; there it is split, so that each fault befalls the very same moment, and each branch is watched: until the
fault was noticed and for a while longer, then without the fault. What is measured is heard on the graph, beside the driver.
First a light session, then a whole one. What is not run this time (`--kinds`, `--phases`, `--faults`) is taken from the JSON file.
"""

from __future__ import annotations

import argparse
import json
import logging
import sys
import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import cv2

from supervisor.experiments.faults_cases import FAULTS, Fault, Phase
from supervisor.experiments.faults_page import page
from supervisor.experiments.faults_split import branch
from supervisor.experiments.faults_stand import Staged, Stand
from supervisor.experiments.faults_watch import PATIENT, Patience, Row, Story, T, lead, watch
from supervisor.experiments.faults_whole import SessionRow, run_whole

KINDS = ("light", "whole")


def run_all(cases: Iterable[tuple[Fault, Phase]], folder: Path, patience: Patience = PATIENT) -> Iterator[Row]:
    """Lead one light session from phase to phase, and let each fault befall a copy of it; the served robot's files go to `folder`."""
    wanted = list(cases)
    stand = Stand(folder)
    for phase in Phase:
        faults = [fault for fault, at in wanted if at is phase]
        if not faults:
            continue
        _play(stand, lead(stand, phase))
        for fault in faults:
            yield branch(partial(_watched, stand, fault, phase, patience), stand.threads_before)


def _watched(stand: Staged, fault: Fault, phase: Phase, patience: Patience) -> Row:
    return _play(stand, watch(stand, fault, phase, patience))


def _play(stand: Staged, story: Story[T]) -> T:
    while True:
        try:
            next(story)
        except StopIteration as ended:
            return ended.value  # type: ignore[no-any-return]
        stand.tick()


def main(arguments: list[str] | None = None) -> int:
    """Run all cases, and write what was found."""
    parser = argparse.ArgumentParser(prog="python -m supervisor.experiments.faults", description="Every fault in every phase.")
    parser.add_argument("--json", type=Path, help="write the rows to this file")
    parser.add_argument("--markdown", type=Path, help="write the page to this file")
    parser.add_argument("--faults", nargs="*", choices=[str(one) for one in FAULTS], help="only these")
    parser.add_argument("--phases", nargs="*", choices=list(Phase), help="only these")
    parser.add_argument("--kinds", nargs="*", choices=KINDS, default=list(KINDS), help="only this kind of session")
    options = parser.parse_args(arguments)
    logging.disable(logging.CRITICAL)  # the sentences are in the rows
    cases = [
        (fault, phase)
        for phase in Phase
        for fault in FAULTS
        if (not options.phases or phase in options.phases) and (not options.faults or fault in options.faults)
    ]
    found: dict[str, list[dict[str, Any]]] = {kind: [] for kind in KINDS}
    if options.json and options.json.exists():
        found |= json.loads(options.json.read_text(encoding="utf-8"))
    order = [(fault.value, phase.value) for phase in Phase for fault in FAULTS]
    wanted = [(fault.value, phase.value) for fault, phase in cases]

    def tell(row: Row) -> None:
        kind = KINDS[isinstance(row, SessionRow)]
        others = [one for one in found[kind] if (one["fault"], one["phase"]) != (row.fault, row.phase)]
        found[kind] = sorted([*others, asdict(row)], key=lambda one: order.index((one["fault"], one["phase"])))
        number = wanted.index((row.fault, row.phase)) + 1
        print(f"{number}/{len(cases)} {kind} {row.phase} {row.fault}: {row.verdict}, {row.outcome}", file=sys.stderr)
        if options.json:
            options.json.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")

    for kind in options.kinds:
        with tempfile.TemporaryDirectory() as folder:
            if kind == "whole":
                cv2.setNumThreads(0)  # a process that is split takes no threads along
                run_whole(cases, Path(folder), tell)
            else:
                for row in run_all(cases, Path(folder)):
                    tell(row)
    if options.markdown:
        options.markdown.write_text(page(found["light"], found["whole"]), encoding="utf-8")
    return 1 if any(row["verdict"] == "not held" for rows in found.values() for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main())
