"""The batched solver: its three forms agree, samples do not know of each other, and bad input is refused."""

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import warp as wp

from hardware.codes import InputError
from skills.expose import xpbd_cuda_kernels, xpbd_kernels
from skills.expose.model import TissueModel
from skills.expose.xpbd import BLOCK, State, XpbdConfig, XpbdSolver, choose_device, rest_state
from skills.expose.xpbd_colours import greedy_colours, schedule
from skills.expose.xpbd_cuda import ColourForm
from skills.expose.xpbd_reference import ReferenceRollout, reference_rollout
from tests.skills.sheets import pulls, rolled, sheet_model

CONFIG = XpbdConfig()


@pytest.fixture(scope="module")
def model() -> TissueModel:
    return sheet_model(21, bump=3e-3)


@pytest.fixture(scope="module")
def small() -> TissueModel:
    return sheet_model(11)


def reference(model: TissueModel, state: State, controls: np.ndarray) -> ReferenceRollout:
    inertia = CONFIG.newtons_per_metre(model)
    positions, adhesion, joined = (np.asarray(part, dtype=np.float64) for part in (state.positions, state.adhesion, state.joined))
    return reference_rollout(
        model, positions, adhesion, joined, controls, inertia=inertia, substeps=CONFIG.substeps, iterations=CONFIG.iterations
    )


def coloured(model: TissueModel, state: State, controls: np.ndarray, samples: int, horizon: int) -> ColourForm:
    """The form of the GPU, run on the processor."""
    plan = schedule(model, CONFIG.newtons_per_metre(model))
    form = ColourForm(model, plan, samples, horizon, substeps=CONFIG.substeps, iterations=CONFIG.iterations, device="cpu")
    seam = (state.joined[:, plan.seam_of] * plan.seam_stiffness).astype(np.float32)
    form.run(state.positions, state.adhesion[:, plan.anchored], seam, controls.astype(np.float32))
    return form


@pytest.mark.parametrize("joined", [0.0, 0.3, 1.0])
def test_the_fast_form_agrees_with_the_reference(model: TissueModel, joined: float) -> None:
    controls = pulls(8, 8)
    state = rest_state(model, joined)
    fast, slow = rolled(model, state, controls), reference(model, state, controls)
    assert abs(fast.positions() - slow.positions).max() < 1e-5
    assert fast.tension == pytest.approx(slow.tension, rel=1e-3)
    assert fast.strain == pytest.approx(slow.strain, abs=1e-4)
    assert fast.final().adhesion == pytest.approx(slow.adhesion, rel=1e-6)
    assert slow.positions[-1][:, model.grasped] == pytest.approx(
        model.rest[model.grasped] + controls.sum(axis=1)[:, None], abs=1e-8
    )


def test_the_form_of_the_gpu_agrees_with_both(model: TissueModel) -> None:
    controls = pulls(5, 8)
    state = rest_state(model, np.linspace(0.0, 1.0, len(model.seams)))
    form = coloured(model, state, controls, 5, 8)
    fast, slow = rolled(model, state, controls), reference(model, state, controls)
    assert abs(form.positions() - slow.positions).max() < 1e-5
    assert abs(form.positions() - fast.positions()).max() < 1e-5
    assert form.tension() == pytest.approx(fast.tension, rel=1e-4)
    assert form.strain() == pytest.approx(fast.strain, abs=1e-5)
    assert (form.last() == form.positions()[-1]).all()
    assert ((form.adhesion() == 0.0) == (fast.final().adhesion[:, model.free & (model.adhesion > 0.0)] == 0.0)).all()


def test_the_form_of_the_gpu_compiles_for_one_without_having_one(tmp_path: Path) -> None:
    if not wp.is_cuda_available() and not _can_compile_for_cuda():
        pytest.skip("this build of Warp has no compiler for CUDA")
    paths = wp.compile_aot_module(xpbd_cuda_kernels, arch=80, module_dir=tmp_path, use_ptx=True)
    code = Path(paths[0]).read_text()
    for kernel in ("predict", "project_edges", "project_hinges", "project_seams", "project_adhesions", "project_floor", "tear"):
        assert f".entry {kernel}_" in code


def _can_compile_for_cuda() -> bool:
    """Whether Warp's library was built with NVRTC."""
    wp.init()
    return bool(wp.get_cuda_supported_archs())


def test_a_processor_whose_instructions_are_refused_gets_plain_ones(small: TissueModel, monkeypatch: pytest.MonkeyPatch) -> None:
    flags: list[str] = []
    load = wp.load_module

    def refuse_once(module: object, device: str) -> None:
        if not flags:
            raise Exception("CPU kernel build failed with error code -1")
        load(module, device=device)

    monkeypatch.setattr(wp, "load_module", refuse_once)
    monkeypatch.setattr(wp, "set_module_options", lambda options, module: flags.append(options["cpu_compiler_flags"]))
    assert rolled(small, rest_state(small), pulls(1, 1)).tension[0, 0] > 0.0
    assert flags == [""]


def test_a_sample_does_not_depend_on_how_many_there_are_or_on_its_place(small: TissueModel) -> None:
    controls = pulls(20, 4)
    state = rest_state(small, 0.5)
    together = rolled(small, state, controls)
    order = np.random.default_rng(3).permutation(20)
    shuffled = rolled(small, state, controls[order])
    assert (together.positions()[:, order] == shuffled.positions()).all()
    assert (together.tension[:, order] == shuffled.tension).all()
    assert (together.strain[:, order] == shuffled.strain).all()
    for sample in (0, 7, 8, 19):
        alone = rolled(small, state, controls[sample : sample + 1])
        assert (alone.positions()[:, 0] == together.positions()[:, sample]).all()
        assert alone.tension[:, 0].tolist() == together.tension[:, sample].tolist()


def test_two_runs_are_equal_to_the_last_bit_whatever_the_threads(small: TissueModel) -> None:
    controls = pulls(24, 4)
    solvers = [XpbdSolver(small, 24, 4, threads=threads) for threads in (1, 2, 3)]
    first = solvers[0].rollout(rest_state(small), controls)
    positions = first.positions()
    for solver in (*solvers, solvers[0]):
        again = solver.rollout(rest_state(small), controls)
        assert (again.positions() == positions).all()
        assert (again.tension == first.tension).all()


def test_steps_one_by_one_are_the_steps_of_one_horizon(small: TissueModel) -> None:
    controls = pulls(3, 4)
    whole = rolled(small, rest_state(small, 0.4), controls)
    state = rest_state(small, 0.4)
    solver = XpbdSolver(small, 3, 1)
    for step in range(4):
        state = solver.rollout(state, controls[:, step : step + 1]).final()
        assert (state.positions == whole.positions()[step]).all()
    final = whole.final()
    assert (final.adhesion == state.adhesion).all()
    assert (final.joined == state.joined).all()


def test_every_sample_may_start_from_a_state_of_its_own(small: TissueModel) -> None:
    controls = pulls(4, 2)
    middle = rolled(small, rest_state(small, 0.2), controls).final()
    own = rolled(small, middle, controls)
    for sample in range(4):
        one = State(*(part[sample : sample + 1] for part in (middle.positions, middle.adhesion, middle.joined)))
        alone = rolled(small, one, controls[sample : sample + 1])
        assert (alone.positions()[:, 0] == own.positions()[:, sample]).all()


def test_each_sample_has_its_own_seams(small: TissueModel) -> None:
    joined = np.stack([np.zeros(len(small.seams)), np.ones(len(small.seams))]).astype(np.float32)
    both = rolled(small, replace(rest_state(small), joined=joined), pulls(1, 8).repeat(2, axis=0)).positions()[-1]
    opening = np.linalg.norm(both[:, small.seams[:, 0]] - both[:, small.seams[:, 1]], axis=2).max(axis=1)
    assert opening[0] > 1e-3
    assert opening[1] < 0.1e-3


def test_the_trajectory_has_the_layout_that_it_says(small: TissueModel) -> None:
    rollout = rolled(small, rest_state(small), pulls(11, 3))
    assert rollout.trajectory.shape == (3, 2, len(small.rest))
    assert rollout.trajectory.dtype is xpbd_kernels.points
    blocks = rollout.trajectory.numpy()  # (h, B, V, 3, 8)
    assert (blocks[:, 1, :, :, 2] == rollout.positions()[:, BLOCK + 2]).all()


def test_a_rollout_that_was_overwritten_is_not_read(small: TissueModel) -> None:
    solver = XpbdSolver(small, 2, 2)
    old = solver.rollout(rest_state(small), pulls(2, 2))
    new = solver.rollout(rest_state(small), pulls(2, 2, seed=5))
    assert new.final().positions.shape == (2, len(small.rest), 3)
    with pytest.raises(RuntimeError, match="overwritten"):
        old.positions()
    with pytest.raises(RuntimeError, match="overwritten"):
        old.final()


def test_constraints_of_one_colour_share_no_vertex_that_moves(model: TissueModel) -> None:
    plan = schedule(model, 1.0)
    for rows, start in ((plan.edges, plan.edge_start), (plan.hinges, plan.hinge_start), (plan.seams, plan.seam_start)):
        assert start[-1] == len(rows)
        for first, end in itertools.pairwise(start):
            moving = rows[first:end][model.free[rows[first:end]]]
            assert len(np.unique(moving)) == len(moving)
    assert len(plan.edge_start) - 1 <= 12
    assert len(plan.hinge_start) - 1 <= 24


def test_colours_are_few_and_those_of_a_path_are_two() -> None:
    path = np.stack([np.arange(9), np.arange(1, 10)], axis=1).astype(np.int32)
    assert greedy_colours(path, np.ones(10, dtype=bool)).tolist() == [0, 1] * 4 + [0]
    held = np.ones(10, dtype=bool)
    held[1::2] = False
    assert set(greedy_colours(path, held).tolist()) == {0, 1}
    assert set(greedy_colours(path, np.zeros(10, dtype=bool)).tolist()) == {0}


def test_what_is_held_on_all_sides_is_left_out(model: TissueModel) -> None:
    plan = schedule(model, 1.0)
    assert model.free[plan.edges].any(axis=1).all()
    assert len(plan.edges) < len(model.edges)
    assert model.grasped[plan.pulling[:, 0]].all()
    assert not model.grasped[plan.pulling[:, 1]].any()
    assert not model.grasped[plan.watched].any()


def test_devices_are_chosen_by_name() -> None:
    assert choose_device("cpu") == "cpu"
    assert choose_device("auto") == ("cuda:0" if wp.is_cuda_available() else "cpu")
    with pytest.raises(InputError, match=r"no device 'cuda:7' here; there is cpu"):
        choose_device("cuda:7")


@pytest.mark.parametrize(
    ("config", "sentence"),
    [({"substeps": 0}, "substeps"), ({"iterations": -1}, "iterations"), ({"inertia": 0.0}, "inertia is 0.0")],
)
def test_a_configuration_that_cannot_run_is_refused(config: dict[str, float], sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        XpbdConfig(**config)  # type: ignore[arg-type]


def test_a_solver_for_nothing_is_refused(small: TissueModel) -> None:
    with pytest.raises(InputError, match="samples"):
        XpbdSolver(small, 0, 4)
    with pytest.raises(InputError, match="horizon"):
        XpbdSolver(small, 4, 0)
    with pytest.raises(InputError, match="threads"):
        XpbdSolver(small, 4, 4, threads=0)


def test_controls_that_do_not_fit_are_refused(small: TissueModel) -> None:
    solver = XpbdSolver(small, 4, 2)
    with pytest.raises(ValueError, match=r"controls have shape \(4, 3, 3\), but this solver takes \(4, 2, 3\)"):
        solver.rollout(rest_state(small), np.zeros((4, 3, 3)))
    with pytest.raises(ValueError, match="controls hold numbers that are not finite"):
        solver.rollout(rest_state(small), np.full((4, 2, 3), np.nan))


@pytest.mark.parametrize(
    ("name", "change", "sentence"),
    [
        ("positions", lambda a: a[:, :-1], "positions have shape"),
        ("positions", lambda a: a.repeat(3, axis=0), "positions have shape"),
        ("positions", lambda a: a * np.nan, "positions hold numbers that are not finite"),
        ("adhesion", lambda a: a - 1.0, "adhesion must be at least 0"),
        ("joined", lambda a: a + 0.5, r"joined must lie in 0\.\.1"),
    ],
)
def test_a_state_that_does_not_fit_is_refused(small: TissueModel, name: str, change: object, sentence: str) -> None:
    state = rest_state(small)
    bad = replace(state, **{name: change(getattr(state, name))})  # type: ignore[operator]
    with pytest.raises(ValueError, match=sentence):
        XpbdSolver(small, 4, 2).rollout(bad, np.zeros((4, 2, 3)))
