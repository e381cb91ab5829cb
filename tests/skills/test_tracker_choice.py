"""The choice of a tracker: each name makes its tracker, and what is missing is said in one sentence."""

import sys
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
import torch

from hardware.codes import InputError
from skills.tracking.choose import TrackerChoice, make_tracker
from skills.tracking.dis import TrackerDIS
from skills.tracking.lk import TrackerLK
from tests.skills import upstream
from tests.skills.pictures import coloured, frame, speckle


def test_dis_anchors_and_dis_chained_and_lk_do_not() -> None:
    dis, chained, lk = (make_tracker(TrackerChoice(kind)) for kind in ("dis", "dis-chained", "lk"))
    assert isinstance(dis, TrackerDIS) and dis.config.anchor is not None
    assert isinstance(chained, TrackerDIS) and chained.config.anchor is None
    assert isinstance(lk, TrackerLK)
    assert isinstance(make_tracker(), TrackerDIS)


@pytest.mark.parametrize("kind", ["dis", "dis-chained", "lk"])
def test_every_built_in_tracker_follows_a_shift(kind: str) -> None:
    texture, points = speckle(1), np.array([[100.0, 100.0], [150.0, 120.0], [200.0, 90.0]])
    tracker = make_tracker(TrackerChoice(kind))
    tracker.start(frame(coloured(texture), 0), points)
    for k in range(1, 5):
        tracks = tracker.update(frame(coloured(np.roll(texture, 2 * k, axis=1)), k))
    assert tracks.visible.all()
    assert tracks.points == pytest.approx(points + np.array([8.0, 0.0]), abs=0.5)
    assert tracks.points == pytest.approx(tracker.tracks().points)


def test_a_choice_is_plain_values() -> None:
    assert asdict(TrackerChoice("raft", "raft.pth", "cuda")) == {"kind": "raft", "weights": "raft.pth", "device": "cuda"}


def test_an_unknown_tracker_names_the_known_ones_and_the_nearest() -> None:
    with pytest.raises(InputError, match=r"no tracker 'litetraker': choose dis, .*did you mean litetracker\?"):
        TrackerChoice("litetraker")


def test_weights_for_a_tracker_without_any_are_an_error() -> None:
    with pytest.raises(InputError, match="dis takes no weights"):
        TrackerChoice("dis", "w.pth")


@pytest.mark.parametrize(
    ("kind", "module", "what"),
    [
        ("litetracker", "src", "lite-tracker and put its folder on PYTHONPATH"),
        ("cotracker3", "cotracker", "pip install git"),
        ("raft", "raft", "RAFT and put its folder core on PYTHONPATH"),
    ],
)
def test_a_missing_package_says_what_to_install(kind: str, module: str, what: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(InputError, match=f"{kind} needs its upstream code: .*{what}"):
        make_tracker(TrackerChoice(kind, "w.pth"))


def test_a_package_that_upstream_itself_lacks_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def lacking(name: str) -> object:
        raise ModuleNotFoundError("No module named 'einops'", name="einops")

    monkeypatch.setattr("skills.tracking.choose.import_module", lacking)
    with pytest.raises(InputError, match="litetracker needs the package einops"):
        make_tracker(TrackerChoice("litetracker", "w.pth"))


@pytest.fixture
def raft(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "raft", upstream.module("raft", RAFT=upstream.RAFT))


@pytest.mark.usefixtures("raft")
def test_missing_weights_say_which_file_and_where_to_get_it(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"needs a checkpoint: give --tracker-weights raft-things\.pth from"):
        make_tracker(TrackerChoice("raft"))
    with pytest.raises(InputError, match=r"no checkpoint .*nowhere\.pth for the tracker raft: get raft-things"):
        make_tracker(TrackerChoice("raft", str(tmp_path / "nowhere.pth")))


@pytest.mark.usefixtures("raft")
def test_a_file_that_is_no_checkpoint_or_another_networks_is_one_sentence(tmp_path: Path) -> None:
    text, other = tmp_path / "text.pth", tmp_path / "other.pth"
    text.write_text("these are no weights")
    torch.save({"something": torch.ones(1)}, other)
    with pytest.raises(InputError, match=r"text\.pth is not a checkpoint of RAFT"):
        make_tracker(TrackerChoice("raft", str(text)))
    with pytest.raises(InputError, match=r"other\.pth are not those of RAFT"):
        make_tracker(TrackerChoice("raft", str(other)))


@pytest.mark.usefixtures("raft")
def test_a_checkpoint_that_would_run_code_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "code.pth"
    torch.save({"gain": Path("a class that is no tensor")}, path)
    with pytest.raises(InputError, match="does not hold plain torch weights"):
        make_tracker(TrackerChoice("raft", str(path)))


def test_a_device_that_is_not_there_is_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(InputError, match="torch sees no GPU here"):
        make_tracker(TrackerChoice("raft", "w.pth", "cuda"))
    with pytest.raises(InputError, match="torch knows no device 'gpu'"):
        make_tracker(TrackerChoice("raft", "w.pth", "gpu"))


def test_importing_upstream_leaves_torchs_generator_as_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def seeding(name: str) -> object:
        torch.manual_seed(0)
        return upstream.module(name, RAFT=upstream.RAFT)

    monkeypatch.setattr("skills.tracking.choose.import_module", seeding)
    path = tmp_path / "w.pth"
    torch.save({"gain": torch.ones(1)}, path)
    torch.manual_seed(7)
    before = torch.random.get_rng_state()
    make_tracker(TrackerChoice("raft", str(path)))
    assert torch.equal(before, torch.random.get_rng_state())
