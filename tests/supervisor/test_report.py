"""The report: one file, true to the record, whatever the record holds."""

from __future__ import annotations

import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import pytest

from hardware.codes import InputError
from supervisor.charts import curves
from supervisor.history import exposures
from supervisor.reading import read
from supervisor.record import Recorder
from supervisor.report import render, write_report
from tests.supervisor.sessions import HEADER, OUTCOME, exposed, exposure_view, record_session, snapshots, truth

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


def svg(page: str, title: str, which: int = 0) -> str:
    """The `which`-th chart of a title."""
    return page.split(f'aria-label="{title}"')[1 + which].split("</svg>")[0]


def test_each_exposure_says_why_it_ended_and_shows_what_was_expected_and_measured(page: str) -> None:
    assert page.count("<h3>Attempt") == 2
    why = "Pulled {} of 35 steps: severed and connected tissue are 3.1 standard deviations apart."
    assert why.format(9) in page and why.format(8) in page
    for title in ("Losses", "Opening of the cut", "Severed from connected", "Tension", "Strain", "Sampled pulls"):
        assert page.count(f'aria-label="{title}"') == 2
    assert ">expected<" in svg(page, "Tension") and ">measured<" in svg(page, "Tension")
    assert ">enough<" in svg(page, "Severed from connected")


def test_the_area_seen_in_truth_stands_beside_the_expected_opening(page: str) -> None:
    assert ">11300<" in svg(page, "Opening of the cut") and ">13400<" in svg(page, "Opening of the cut", 1)


def test_a_step_that_was_planned_but_not_made_is_not_drawn(page: str) -> None:
    points = [svg(page, "Losses", which).split('points="')[1].split('"')[0].split() for which in (0, 1)]
    assert [len(p) for p in points] == [9, 8]


def test_a_reading_that_is_missing_leaves_a_gap(page: str) -> None:
    assert len(svg(page, "Strain").split('points="')[1].split('"')[0].split()) == 8


def test_losses_below_zero_stay_within_their_chart() -> None:
    drawn = curves("Losses", "", [("deform", "#000", [-1.0, -5.0, -3.0])])
    heights = [float(point.split(",")[1]) for point in drawn.split('points="')[1].split('"')[0].split()]
    assert min(heights) >= 34 and max(heights) <= 168 and heights[1] > heights[2] > heights[0]


def test_exposures_of_a_record_older_than_the_controller_are_told_by_their_end_alone(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "s", HEADER)
    for snapshot in snapshots(images=False):
        recorder.snapshot(replace(snapshot, exposure=None))
        if abs(snapshot.stamp - 18.9) < 1e-6:
            old = {"code": "ok", "message": "pulled all 35 steps", "stopped_by": "exposure_steps_done", "steps": 35}
            recorder.write("exposed", snapshot.stamp, old)
    recorder.close(OUTCOME)
    page = render(read(tmp_path / "s"))
    parsed(page)
    assert "<h3>Attempt 1</h3><p class='note'>Pulled all 35 steps.</p></div>" in page and "Opening of the cut" not in page


def test_a_session_without_exposures_has_no_section_on_them(tmp_path: Path) -> None:
    assert "<h2>Exposure</h2>" not in render(read(record_session(tmp_path / "s", until=10.0, images=False)))


def test_a_straight_pull_shows_what_was_measured_only(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "s", HEADER)
    straight = {name: value for name, value in exposed(6).items() if name not in ("forecast", "planned")}
    recorder.snapshot(replace(next(snapshots(images=False)), attempt=1))
    recorder.write("exposed", 1.0, straight)
    recorder.write("truth", 1.1, truth(1))
    recorder.close(OUTCOME)
    page = render(read(tmp_path / "s"))
    assert 'aria-label="Tension"' in page and 'aria-label="Strain"' in page
    assert ">expected<" not in page and 'aria-label="Losses"' not in page
    assert "In truth the camera sees 11300 px of the opened cut." in page


def test_an_exposure_cut_short_by_a_kill_shows_its_steps_and_says_so(tmp_path: Path) -> None:
    page = render(read(record_session(tmp_path / "s", until=16.6, close=False, images=False)))
    parsed(page)
    assert "did not come to its end; step 5 is the last that was planned" in page
    assert 'aria-label="Opening of the cut"' in page and 'aria-label="Strain"' not in page


def test_an_interrupted_exposure_is_not_taken_for_the_one_after_it(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "s", HEADER)
    first = next(snapshots(images=False))
    for stamp, view in ((1.0, exposure_view(1, 1)), (2.0, exposure_view(1, 2)), (5.0, exposure_view(2, 1))):
        recorder.snapshot(replace(first, stamp=stamp, attempt=1, exposure=view))
    recorder.write("exposed", 6.0, exposed(1))
    recorder.close(OUTCOME)
    broken, whole = exposures(read(tmp_path / "s"))
    assert (broken.message, broken.steps, broken.attempt) == ("", 2, 1)
    assert (whole.steps, whole.start, whole.end) == (1, 5.0, 6.0) and whole.message.startswith("pulled 1 of 35")
    page = render(read(tmp_path / "s"))
    assert "<h3>Attempt 1</h3>" in page and "<h3>Attempt 1, exposure 2</h3>" in page


def test_how_far_apart_a_step_brought_the_hypotheses_is_read_from_the_next_one(tmp_path: Path) -> None:
    (exposure,) = exposures(read(record_session(tmp_path / "s", until=16.6, close=False, images=False)))
    assert exposure.series["separation"] == pytest.approx([0.6, 0.9, 1.2, 1.5])
    assert exposure.series["opening"] == pytest.approx([400.0, 800.0, 1200.0, 1600.0, 2000.0])


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
