"""Fits that are interrupted, resumed, shared by processes, bounded in memory, or stopped by rays they do not see."""

import json
import os
import signal
import socket
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from support.gaussian_scenes import PIXEL, circular, small_model, small_scan, spectral_model

from recon.data.array_store import ArrayStore, read_part, release
from recon.gaussians.likelihood import likelihood
from recon.gaussians.optimize import SNAPSHOTS, fit
from recon.gaussians.processes import joined
from recon.gaussians.recipe import Recipe, Stage
from recon.gaussians.state import FitState
from recon.ops.deviance import chi_square
from recon.runs.checkpoint import identity, read_checkpoint, write_checkpoint
from recon.runs.unfinished_run import CHECKPOINT, LOG, START, Interruption, PartialRun, is_partial
from recon.runs.write_run import RunFolder, Stopped
from spectra.errors import DatasetError, InputError

PARTS = ("centres", "log_scales", "quaternions", "coefficients")
RECIPE = Recipe(stages=(Stage(2.0, 2.0), Stage(1.0, 3.0)), views_per_step=3)
STEPS = 15


def toy_problem():
    """A scan of thirty Gaussians with noise, and a start that knows them badly."""
    truth = small_model(1, count=30)
    shift = torch.from_numpy(np.random.default_rng(2).normal(scale=0.3, size=(30, 3))).float()
    start = replace(truth, centres=truth.centres + shift, coefficients=truth.coefficients.mean().expand(30, 3).clone())
    return start, small_scan(truth, circular(16, 16, views=9), spectral_model(3), seed=3)


@pytest.fixture(scope="module")
def problem():
    return toy_problem()


@pytest.fixture(scope="module")
def uninterrupted(problem):
    return fit(*problem, PIXEL, RECIPE)


def same(one, other):
    return all(torch.equal(getattr(one, name), getattr(other, name)) for name in PARTS)


@pytest.mark.parametrize("step", [1, 5, 6, 7, 14])
def test_a_fit_that_is_put_down_after_any_step_and_taken_up_again_gives_the_same_bits(
    step, problem, uninterrupted, tmp_path
):
    states = []
    fit(*problem, PIXEL, RECIPE, lambda p: states.append(p.state) or p.step == step)
    assert len(states) == step
    write_checkpoint(tmp_path / "state", states[-1].tensors(), states[-1].numbers())
    state = FitState.restore(*read_checkpoint(tmp_path / "state"))
    seen = []
    fitted = fit(state, problem[1], PIXEL, RECIPE, lambda p: seen.append(p.step))
    assert seen == list(range(step + 1, STEPS + 1))
    assert same(fitted, uninterrupted)


def test_a_checkpoint_is_whole_or_the_one_before(tmp_path, monkeypatch):
    path = tmp_path / "state"
    write_checkpoint(path, {"a": torch.ones(3)}, {"done": 1})

    def killed(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("recon.runs.checkpoint.os.replace", killed)
    with pytest.raises(KeyboardInterrupt):
        write_checkpoint(path, {"a": torch.zeros(3)}, {"done": 2})
    tensors, content = read_checkpoint(path)
    assert (tensors["a"].tolist(), content) == ([1, 1, 1], {"done": 1})


@pytest.mark.parametrize("content", [b"", b"no checkpoint", b"\x00" * 100])
def test_a_damaged_checkpoint_is_one_sentence(content, tmp_path):
    (tmp_path / "state").write_bytes(content)
    with pytest.raises(DatasetError, match="not a checkpoint written by recon"):
        read_checkpoint(tmp_path / "state")


def partial(folder, measured, options=None):
    run = PartialRun(folder, ("a", "b", "c", "d"), options or {"seed": 0})
    return run, run.found(measured)


def test_a_partial_run_goes_on_with_its_log(problem, tmp_path):
    start, measured = problem
    run, found = partial(tmp_path, measured)
    assert found is None
    assert not is_partial(tmp_path)
    volumes = np.ones((3, 2, 2, 2), np.float32)
    state = FitState.begin(start)
    run.begin(volumes, {"fdk": 1.0}, state)
    assert is_partial(tmp_path)

    def on_step(progress):
        run.add(progress)
        if progress.step == 4:
            run.save(progress.state)
        return progress.step == 6

    fit(state, measured, PIXEL, RECIPE, on_step)
    with (tmp_path / LOG).open("a") as file:
        file.write('{"step": 7, "sec')  # torn by kill -9
    again, (state, back, seconds) = partial(tmp_path, measured)
    assert (state.done, seconds) == (4, {"fdk": 1.0})
    np.testing.assert_array_equal(back, volumes)
    fit(state, measured, PIXEL, RECIPE, again.add)
    lines = [json.loads(line) for line in (tmp_path / LOG).read_text().splitlines()]
    assert [line["step"] for line in lines] == list(range(1, STEPS + 1))
    assert set(lines[0]) == {"step", "seconds", "deviance", *(f"chi_square_{c}" for c in "abcd")}
    assert sorted(again.snapshots()) == list(range(1, STEPS + 1, STEPS // SNAPSHOTS))


@pytest.mark.parametrize(("change", "words"), [("options", "another seed"), ("dataset", "another dataset")])
def test_a_run_of_other_options_or_data_refuses_to_resume(change, words, problem, tmp_path):
    start, measured = problem
    run, _ = partial(tmp_path, measured)
    run.begin(np.zeros((3, 2, 2, 2), np.float32), {}, FitState.begin(start))
    before = {path: path.read_bytes() for path in tmp_path.iterdir() if path.is_file()}
    other = replace(measured, counts=measured.counts + 1) if change == "dataset" else measured
    with pytest.raises(InputError, match=f"cannot be resumed, as it was begun with {words}: "):
        partial(tmp_path, other, {"seed": 1} if change == "options" else None)
    assert {path: path.read_bytes() for path in tmp_path.iterdir() if path.is_file()} == before


def test_the_identity_of_a_scan_holds_all_that_was_measured(problem):
    measured = problem[1]
    first = identity(measured, {})
    changed = [
        replace(measured, gains=measured.gains * 2),
        replace(measured, exposure=measured.exposure * 2),
        replace(measured, geometry=circular(16, 16, views=9, pitch=1.6)),
        replace(measured, transmission=spectral_model(3, photons=2e5)),
    ]
    assert identity(measured, {}) == first
    assert all(identity(other, {})["dataset"] != first["dataset"] for other in changed)


def interrupted(run, error, **content):
    """A run that ends by an error when its fit has begun."""
    with RunFolder(run, overwrite=False) as part:
        for name in (START, CHECKPOINT, *content):
            (part / name).write_text(content.get(name, ""))
        raise error


def test_a_fit_that_was_stopped_gets_its_name_and_goes_on_from_there(tmp_path):
    run = tmp_path / "run"
    files = {"metrics.json": "{}", "model.safetensors": "mine"}
    with pytest.raises(KeyboardInterrupt, match=r"run holds the model after step 3 of 9.*--resume"):
        interrupted(run, Stopped("after step 3 of 9"), **files)
    assert (run / "model.safetensors").read_text() == "mine"
    with pytest.raises(InputError, match="interrupted run finished: go on by --resume"):
        RunFolder(run, overwrite=False)
    with RunFolder(run, overwrite=False, resume=True) as part:
        assert is_partial(part)
        assert not run.exists()
    assert sorted(path.name for path in run.iterdir()) == ["figures", "metrics.json", "model.safetensors"]


@pytest.mark.parametrize("error", [KeyboardInterrupt, RuntimeError])
def test_what_was_fitted_is_kept_after_an_interruption_or_a_fault(error, tmp_path):
    run = tmp_path / "run"
    with pytest.raises(error):
        interrupted(run, error())
    assert is_partial(tmp_path / "run.part")
    with pytest.raises(InputError, match="--resume, or anew by --overwrite"):
        RunFolder(run, overwrite=False)
    with RunFolder(run, overwrite=True) as part:
        assert not is_partial(part)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_first_interruption_asks_and_the_second_ends(number):
    before = signal.getsignal(number)
    with Interruption() as interruption:
        assert not interruption.asked
        signal.raise_signal(number)
        assert interruption.asked
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(number)
    assert signal.getsignal(number) is before


def test_arrays_on_disk_hold_what_arrays_in_memory_do(problem, uninterrupted, tmp_path):
    measured = problem[1]
    counts = ArrayStore(tmp_path).empty("counts", measured.counts.shape)
    counts[:] = measured.counts
    release(counts)
    assert isinstance(counts, np.memmap)
    assert not isinstance(read_part(counts, slice(0, 2)), np.memmap)
    assert same(fit(problem[0], replace(measured, counts=counts), PIXEL, RECIPE), uninterrupted)


def test_chi_square_is_about_one_where_the_model_is_right():
    rng = np.random.default_rng(1)
    expected = torch.from_numpy(rng.uniform(5, 1e4, 20000))
    counts = torch.from_numpy(rng.poisson(expected).astype(float))
    assert chi_square(counts, expected).mean().item() == pytest.approx(1, abs=0.05)
    assert chi_square(torch.tensor([3.0]), torch.tensor([0.0])).item() == 9.0


def test_agreement_leaves_blind_pixels_and_channels_out(problem):
    start, measured = problem
    gains = measured.gains.copy()
    gains[0], gains[1, :8] = 0, 0
    blind = replace(measured, gains=gains, counts=measured.counts * (gains > 0))
    found = likelihood(start, blind, 0.0).chi_square
    assert np.isnan(found[0])
    whole = likelihood(start, measured, 0.0).chi_square
    np.testing.assert_allclose(found[2:], whole[2:])
    assert found[1] != whole[1]


def test_a_fit_ends_when_chi_square_on_held_out_rays_no_longer_falls(problem):
    start, measured = problem
    held, steps = measured[[4]], []
    recipe = replace(RECIPE, stages=(Stage(1.0, 40.0),))
    wrong = replace(held, counts=held.counts[..., ::-1].copy())  # what fits better and better does not fit these
    fit(start, measured, PIXEL, recipe, steps.append, held_out=wrong)
    judged = [p for p in steps if p.held_out is not None]
    assert all(p.snapshot for p in judged)
    assert len(steps) < steps[0].steps
    assert min(p.held_out.mean() for p in judged[-2:]) >= min(p.held_out.mean() for p in judged[:-2])


def test_held_out_views_that_agree_do_not_end_a_fit_before_its_time(problem):
    start, measured = problem
    steps = []
    fit(start, measured, PIXEL, RECIPE, steps.append, held_out=measured)
    assert steps[-1].held_out.mean() < steps[0].held_out.mean()


def test_a_recipe_refuses_a_negative_number_of_held_out_views():
    with pytest.raises(InputError, match="held_out must be a number of views, 0 or more, got -1"):
        Recipe(held_out=-1)


WORKER = """
import sys
import weakref
sys.path[:0] = {paths!r}
import torch
from test_long_runs import PIXEL, RECIPE, toy_problem
from recon.gaussians.optimize import fit
from recon.gaussians.processes import joined
from recon.gaussians.processes import Resources
with joined() as processes:
    group = weakref.ref(torch.distributed.group.WORLD)
    import torch._dynamo  # whatever is imported meanwhile
    start, measured = toy_problem()
    start = processes.from_first(start)
    steps = []
    fitted = fit(start, measured, PIXEL, RECIPE, steps.append, measured[[2]], resources=Resources(processes))
    rows = [p.deviance for p in steps]
    torch.save([fitted.centres, fitted.coefficients, rows], sys.argv[1] + str(processes.rank))
assert group() is None, "threads of a group that outlives its processes' context may abort them at their end"
"""


@pytest.mark.slow
def test_two_processes_give_what_one_gives_within_rounding(problem, tmp_path):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = str(free.getsockname()[1])
    script = tmp_path / "worker.py"
    here = Path(__file__).parent
    script.write_text(WORKER.format(paths=[str(here), str(here.parents[1]), str(here.parents[2])]))
    environment = {
        **os.environ, "MASTER_ADDR": "127.0.0.1", "MASTER_PORT": port, "WORLD_SIZE": "2", "OMP_NUM_THREADS": "1",
        **({"GLOO_SOCKET_IFNAME": "lo"} if sys.platform == "linux" else {}),
    }  # fmt: skip
    command = [sys.executable, str(script), str(tmp_path / "out")]
    running = [subprocess.Popen(command, env={**environment, "RANK": str(rank)}) for rank in range(2)]
    assert [process.wait(timeout=300) for process in running] == [0, 0]
    first, second = (torch.load(tmp_path / f"out{rank}") for rank in range(2))
    assert torch.equal(first[0], second[0])
    assert torch.equal(first[1], second[1])
    rows = []
    alone = fit(*problem, PIXEL, RECIPE, lambda p: rows.append(p.deviance), problem[1][[2]])
    np.testing.assert_allclose(first[2][0], rows[0], rtol=1e-6)
    np.testing.assert_allclose(first[2], rows, rtol=1e-3)
    np.testing.assert_allclose(first[0], alone.centres, atol=1e-3)
    np.testing.assert_allclose(first[1], alone.coefficients, atol=1e-3 * alone.coefficients.max().item())


@pytest.mark.parametrize(("rank", "count"), [("2", "2"), ("x", "2"), ("0", "many")])
def test_processes_that_make_no_sense_are_one_sentence(rank, count, monkeypatch):
    monkeypatch.setenv("RANK", rank)
    monkeypatch.setenv("WORLD_SIZE", count)
    with pytest.raises(InputError, match="start several of them by torchrun"), joined():
        pass


@pytest.mark.parametrize("place", [-1, -9, 0.5])
def test_a_checkpoint_with_a_flipped_bit_is_not_resumed(place, tmp_path):
    path = tmp_path / "state"
    write_checkpoint(path, {"a": torch.ones(3), "b": torch.zeros(2, dtype=torch.int64)}, {"done": 1, "least": 0.25})
    data = bytearray(path.read_bytes())
    at = place if isinstance(place, int) else data.index(b"0.25")
    data[at] ^= 1
    path.write_bytes(data)
    with pytest.raises(DatasetError, match="damaged, as it does not fit its digest: begin anew by --overwrite"):
        read_checkpoint(path)
