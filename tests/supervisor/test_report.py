"""The report: one file, true to the record, whatever the record holds."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path

import pytest

from hardware.codes import InputError
from supervisor.reading import read
from supervisor.record import Recorder
from supervisor.report import render, write_report
from tests.supervisor.sessions import HEADER, OUTCOME, record_session, snapshots

VOID = {"meta", "link", "br", "img", "hr"}


class _Checker(HTMLParser):
    """Collects what a page refers to, and fails on tags that do not match."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.references: list[str] = []
        self.tags: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.references += [value or "" for name, value in attrs if name in ("src", "href")]
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def parsed(page: str) -> _Checker:
    checker = _Checker()
    checker.feed(page)
    assert checker.open == []
    return checker


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> str:
    return write_report(record_session(tmp_path_factory.mktemp("sessions") / "one")).read_text()


def test_the_report_is_one_file_without_scripts(page: str) -> None:
    checker = parsed(page)
    assert checker.references and all(reference.startswith("data:image/") for reference in checker.references)
    assert "script" not in checker.tags and "link" not in checker.tags
    assert "@import" not in page and "url(" not in page


def test_the_report_tells_the_outcome_and_the_key_facts(page: str) -> None:
    for said in (
        "Complete",
        OUTCOME["message"],
        "0.62 mm",
        "2 <small>of 3",
        "4 refused",
        "Research software, not for clinical use",
    ):
        assert str(said) in page


def test_the_report_shows_limits_versions_and_settings(page: str) -> None:
    for said in ("tension_stop", "warp-lang", "1.19.0", "expose.steps", "stub, exact"):
        assert said in page


def test_the_report_shows_first_last_and_estimated_images(page: str) -> None:
    assert page.count("data:image/jpeg;base64,") == 4
    assert "Attempt 1, estimate at 19.0 s" in page and "the last image" in page


def test_edges_across_the_goal_are_drawn_by_their_state(page: str) -> None:
    figure = page[page.index('aria-label="Attempt 1, estimate') :]
    strong = re.findall(r'stroke="(#\w+)" stroke-width="2.8"', figure[: figure.index("</figure>")])
    assert (strong.count("#35c46a"), strong.count("#ff4b3e"), strong.count("#b9bec4")) == (3, 12, 2)


def test_the_truth_stands_beside_the_estimate(page: str) -> None:
    assert "Cut ratio" in page and "Length deviation" in page and ">truth<" in page


def test_without_truth_only_the_estimate_is_plotted(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "s", HEADER)
    for snapshot in snapshots(images=False):
        recorder.snapshot(snapshot)
    recorder.close(OUTCOME)
    page = render(read(tmp_path / "s"))
    parsed(page)
    assert "Cut ratio" not in page and ">truth<" not in page
    assert "supervisor&#x27;s own estimate" in page or "supervisor's own estimate" in page
    assert "No image was recorded" in page


def test_an_unclosed_session_gets_a_report_that_says_so(tmp_path: Path) -> None:
    page = write_report(record_session(tmp_path / "s", until=16.0, close=False)).read_text()
    parsed(page)
    assert "Not closed" in page and "16.0 s" in page
    assert '<section class="outcome bad">' in page


@pytest.mark.parametrize("until", [-1.0, 0.0, 2.5])
def test_a_session_that_hardly_began_gets_a_report(tmp_path: Path, until: float) -> None:
    parsed(write_report(record_session(tmp_path / "s", until=until, close=False)).read_text())


def test_a_belief_that_the_truth_contradicts_is_not_shown_as_good(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "s", HEADER)
    recorder.close({**OUTCOME, "success": False, "attachments": 1})
    page = render(read(tmp_path / "s"))
    assert '<section class="outcome fair">' in page and "truth disagrees" in page


def test_words_from_outside_are_escaped(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "s", {**HEADER, "scene": "<script>x</script>", "configuration": {"$odd": "<b>"}})
    recorder.close({**OUTCOME, "message": "<img src=x>"})
    page = render(read(tmp_path / "s"))
    parsed(page)
    assert "<script>" not in page and "<img" not in page and "&lt;b&gt;" in page


def test_no_session_is_one_clear_sentence(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no session record"):
        write_report(tmp_path)
