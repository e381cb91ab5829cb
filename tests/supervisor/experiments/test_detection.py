"""Running the detection experiment: its variants, a journal that goes on where it was, and what is written and drawn."""

import json
from xml.etree import ElementTree

import pytest
from rich.console import Console

from hardware.codes import InputError
from skills.estimate.rule import Rule
from supervisor.experiments import detection, detection_charts
from supervisor.experiments.detection import DetectionSettings, Job, run_experiment, run_job, variants, write_rows
from supervisor.experiments.detection_summary import rows, tables
from tests.supervisor.experiments.detection_runs import failed, run


def test_variants_are_the_chosen_tracker_and_what_it_is_compared_with():
    assert list(variants(DetectionSettings())) == ["dis"]
    assert list(variants(DetectionSettings(compare=True))) == ["dis", "lk", "dis-chained", "elongation"]
    assert list(variants(DetectionSettings(tracker="lk", compare=True))) == ["lk", "dis-chained", "elongation"]


def test_each_variant_has_its_tracker_and_rule(tmp_path):
    settings = DetectionSettings(tracker="raft", weights=tmp_path / "raft.pth", device="cuda:0", compare=True)

    chosen = {name: (config.choice.kind, config.rule) for name, config in variants(settings).items()}

    assert chosen == {
        "raft": ("raft", Rule.LIKELIHOOD),
        "lk": ("lk", Rule.LIKELIHOOD),
        "dis-chained": ("dis-chained", Rule.LIKELIHOOD),
        "elongation": ("dis", Rule.ELONGATION),
    }
    main = variants(settings)["raft"].choice
    assert (main.weights, main.device) == (str(tmp_path / "raft.pth"), "cuda:0")


@pytest.fixture
def made_up(monkeypatch) -> list[Job]:
    """Runs are made up instead of run; the jobs that were asked for are listed."""
    asked: list[Job] = []

    def results(work, jobs, workers):
        for job in jobs:
            asked.append(job)
            yield run(job.seed, variant=job.variant)

    monkeypatch.setattr(detection.pool, "results", results)
    return asked


def test_the_experiment_goes_on_after_the_runs_that_ended(tmp_path, made_up):
    journal, told = tmp_path / "d.trials.jsonl", []
    run_experiment(DetectionSettings(cases=2), journal)
    with journal.open("a") as file:
        file.write('{"settings": {"experiment"')  # a line cut off by a kill
    made_up.clear()

    figures, edges = run_experiment(DetectionSettings(cases=3, compare=True), journal, progress=told.append)

    assert [(job.seed, job.variant) for job in made_up if job.variant == "dis"] == [(2, "dis")]
    assert len(made_up) == 1 + 3 * 3
    assert len(told) == 12
    assert len(figures["per_case"]) == 3
    assert list(figures["variants"]) == ["dis", "lk", "dis-chained", "elongation"]
    assert len(edges) == 12


def test_runs_with_other_weights_are_not_used_again(tmp_path, made_up):
    journal, weights = tmp_path / "d.trials.jsonl", tmp_path / "raft.pth"
    for content in (b"one", b"two"):
        weights.write_bytes(content)
        run_experiment(DetectionSettings(cases=1, tracker="raft", weights=weights), journal)

    assert len(made_up) == 2


def test_weights_that_cannot_be_read_are_said_before_anything_is_pulled(tmp_path, made_up):
    with pytest.raises(InputError, match="cannot be read"):
        run_experiment(DetectionSettings(cases=1, tracker="raft", weights=tmp_path / "none.pth"), tmp_path / "j.jsonl")
    assert made_up == []


def test_the_figures_name_what_the_issue_asks_for_and_hold_no_folder(tmp_path, made_up):
    settings = DetectionSettings(cases=2, tracker=str(tmp_path / "flow.onnx"))
    (tmp_path / "flow.onnx").write_bytes(b"")

    figures, _ = run_experiment(settings, tmp_path / "j.jsonl")

    asked = "detection_accuracy balanced_accuracy precision recall false_severed_rate brier unknown_rate ms_per_frame by_material"
    assert figures.keys() >= {*asked.split(), "confusion", "reliability", "wilson", "goal_edges", "per_case"}
    assert figures["tracker"] == "flow.onnx"
    assert str(tmp_path) not in json.dumps(figures, allow_nan=False)


def test_every_figure_can_be_said_even_of_cases_that_failed(tmp_path, monkeypatch):
    monkeypatch.setattr(
        detection.pool, "results", lambda work, jobs, workers: (failed(seed=job.seed, variant=job.variant) for job in jobs)
    )
    figures, _ = run_experiment(DetectionSettings(cases=2, compare=True), tmp_path / "j.jsonl")
    console = Console(width=200, record=True, file=(tmp_path / "out.txt").open("w"))

    console.print(*tables(figures))

    said = console.export_text()
    assert "edges across the goal" in said
    assert "cases not judged" in said
    assert all(name in said for name in ("dis-chained", "elongation", "beef"))


def test_rows_are_written_one_line_each(tmp_path):
    write_rows(tmp_path / "d.edges.jsonl", rows([run(0), run(1)]))

    assert [json.loads(line)["seed"] for line in (tmp_path / "d.edges.jsonl").read_text().splitlines()] == [0, 1]
    with pytest.raises(InputError, match="cannot be written"):
        write_rows(tmp_path / "nowhere" / "d.edges.jsonl", [])


def test_the_reliability_diagram_is_a_drawing_with_both_kinds_of_edges(tmp_path, made_up, capsys):
    figures, _ = run_experiment(DetectionSettings(cases=2), tmp_path / "j.jsonl")
    (tmp_path / "d.json").write_text(json.dumps(figures))

    assert detection_charts.main([str(tmp_path / "d.json"), str(tmp_path / "charts")]) == 0

    drawn = (tmp_path / "charts" / "detection-reliability.svg").read_text()
    said = "".join(ElementTree.fromstring(drawn).itertext())
    assert "all edges" in said and "edges across the goal" in said
    assert drawn.count("<circle") == 4  # two bins hold edges, in each diagram
    assert "nan" not in drawn.lower().replace("sans", "")
    assert detection_charts.main([]) == 2


def test_a_job_says_which_variant_it_ran(monkeypatch):
    monkeypatch.setattr(detection, "run_case", lambda case, config: {"seed": case.seed})

    assert run_job(Job(DetectionSettings(), "dis", 107)) == {"variant": "dis", "seed": 107}
