"""The autonomy experiment's bookkeeping: intervals, summaries, and a journal that an interruption cannot spoil."""

import json

import pytest

from supervisor.experiments import autonomy
from supervisor.experiments import journal as journal_module
from supervisor.experiments.autonomy import AutonomySettings, run_experiment, summary
from supervisor.experiments.statistics import mean_sd, wilson


def trial(seed: int, success: bool = True, attachments: int = 0, outcome: str = "complete", attempts: int = 1) -> dict:
    per_attempt = [
        {"attachments": attachments, "effective_cut_ratio": 0.5 + 0.1 * k, "excessive_cut_ratio": 0.1 * k}
        for k in range(attempts)
    ]
    return {
        "seed": seed,
        "outcome": outcome,
        "success": success,
        "attachments": attachments,
        "length_deviation_m": 1e-3 * (1 + seed % 2),
        "false_done": outcome == "complete" and attachments > 0,
        "per_attempt": per_attempt,
    }


@pytest.fixture
def counted(monkeypatch) -> list[int]:
    """Trials are made up instead of run; the seeds that were asked for are listed."""
    asked: list[int] = []

    def made_up(settings, seeds, workers):
        for seed in seeds:
            asked.append(seed)
            yield trial(seed)

    monkeypatch.setattr(autonomy, "_trials", made_up)
    return asked


def test_wilson_gives_the_interval_of_the_textbook():
    low, high = wilson(8, 10)

    assert (low, high) == (pytest.approx(0.490, abs=1e-3), pytest.approx(0.943, abs=1e-3))


@pytest.mark.parametrize(("successes", "trials"), [(0, 0), (0, 40), (40, 40)])
def test_wilson_stays_between_zero_and_one(successes, trials):
    low, high = wilson(successes, trials)

    assert 0.0 <= low <= high <= 1.0


def test_one_value_has_no_spread():
    assert mean_sd([3.0]) == {"mean": 3.0, "sd": 0.0}


def test_the_summary_counts_successes_attachments_and_false_completions():
    trials = [trial(0), trial(1, False, 2), trial(2, False, 1, "attempts_used")]

    figures = summary(AutonomySettings(trials=3), trials, 1.0)

    assert figures["success_rate"] == pytest.approx(1 / 3)
    assert figures["attachments"] == {"total": 3, "mean": 1.0}
    assert figures["false_done_rate"] == pytest.approx(1 / 3)
    assert figures["outcomes"] == {"attempts_used": 1, "complete": 2}


def test_a_trial_that_ended_earlier_keeps_its_last_value():
    figures = summary(AutonomySettings(trials=2, attempts=3), [trial(0, attempts=1), trial(1, attempts=3)], 1.0)

    assert figures["effective_cut_ratio"] == pytest.approx([0.5, 0.55, 0.6])


def test_an_interrupted_experiment_goes_on_after_the_trials_that_ended(tmp_path, counted):
    journal = tmp_path / "j.jsonl"
    run_experiment(AutonomySettings(trials=3), journal)
    with journal.open("a") as file:
        file.write('{"settings": {"scene"')  # a line cut off by a kill
    counted.clear()

    figures = run_experiment(AutonomySettings(trials=5), journal)

    assert counted == [3, 4]
    assert figures["trials"] == 5


def test_trials_of_another_condition_or_program_are_not_used_again(tmp_path, counted, monkeypatch):
    journal = tmp_path / "j.jsonl"
    run_experiment(AutonomySettings(trials=2), journal)
    counted.clear()

    run_experiment(AutonomySettings(trials=2, feedback=False), journal)
    assert counted == [0, 1]
    counted.clear()
    monkeypatch.setattr(journal_module, "program", lambda: "another")
    run_experiment(AutonomySettings(trials=2), journal)
    assert counted == [0, 1]


def test_trials_of_another_exposure_and_those_of_journals_older_than_the_choice_are_not_used_again(tmp_path, counted):
    journal = tmp_path / "j.jsonl"
    run_experiment(AutonomySettings(trials=2), journal)
    old = [json.loads(line) for line in journal.read_text().splitlines()]
    for entry in old:
        del entry["settings"]["expose"]
    journal.write_text("".join(json.dumps(entry) + "\n" for entry in old))
    counted.clear()

    run_experiment(AutonomySettings(trials=2), journal)
    assert counted == [0, 1]
    counted.clear()
    figures = run_experiment(AutonomySettings(trials=2, expose="naive"), journal)
    assert counted == [0, 1]
    assert figures["expose"] == "naive"


def test_a_trial_exposes_as_it_is_told(monkeypatch):
    chosen = []

    class StoppedError(Exception):
        pass

    def session(bench, setup, *rest, **more):
        chosen.append(setup.skills.exposure)
        raise StoppedError

    monkeypatch.setattr(autonomy, "Session", session)
    for kind in ("naive", "optimal"):
        with pytest.raises(StoppedError):
            autonomy.run_trial(AutonomySettings(expose=kind), 1)
    assert chosen == ["naive", "optimal"]


def test_the_journal_has_one_readable_line_for_each_trial(tmp_path, counted):
    journal = tmp_path / "j.jsonl"
    run_experiment(AutonomySettings(trials=2), journal)

    assert [json.loads(line)["trial"]["seed"] for line in journal.read_text().splitlines()] == [0, 1]
