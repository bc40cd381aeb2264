"""``recon stress``: cases pass, results that are wrong are noticed, and scans are made worse step by step."""

import json
import shutil
from dataclasses import replace

import h5py
import numpy as np
import pytest
from click.testing import CliRunner
from support.tiny_scans import make, one_sentence

from phantomgen.stress.case import Case, Point
from phantomgen.stress.report import FILES
from phantomgen.stress.run import run_cases
from recon.cli.main import main as recon
from recon.stress import decomposition, projector, scans
from recon.stress.cases import CASES

NAMED = {case.name: case for case in CASES}


@pytest.mark.parametrize("name", NAMED)
def test_a_case_passes(name):
    outcome = NAMED[name].run()
    assert len(outcome.points) >= 4
    assert outcome.passed, outcome.to_dict()


def test_a_projector_that_misplaces_gaussians_is_noticed(monkeypatch):
    right = projector.rasterize
    monkeypatch.setattr(projector, "rasterize", lambda centres, *rest: right(centres + 0.1, *rest))
    assert not NAMED["needles"].run().passed


def test_a_decomposition_with_a_bias_is_noticed(monkeypatch):
    right = decomposition.decompose

    def biased(*arguments, **options):
        lengths, fishers = right(*arguments, **options)
        return lengths + 0.01, fishers

    monkeypatch.setattr(decomposition, "decompose", biased)
    decomposition._estimates.cache_clear()
    for name in ("photons", "near-edges", "threshold", "faint"):
        assert not NAMED[name].run().passed, name
    decomposition._estimates.cache_clear()


def test_the_bias_of_maximum_likelihood_has_a_known_size():
    """Half of the bias for twice the photons; that of the prior, which falls alike, is part of it."""
    model = decomposition._transmission(("I",), decomposition._OF_IODINE)
    lengths = np.array([*decomposition._BODY, 0.01])
    twice = replace(model, weights=2 * model.weights)
    free = [decomposition._bias(m, lengths) for m in (model, twice)]
    np.testing.assert_allclose(free[1], free[0] / 2, rtol=0.02)


@pytest.fixture(scope="module")
def scan(tmp_path_factory):
    return make(tmp_path_factory.mktemp("stress") / "tiny.h5", "--set", "geometry.views=9")


def test_a_scan_is_made_worse_and_its_fits_are_compared(scan, monkeypatch):
    trap = next(trap for trap in scans._TRAPS if trap.name == "dose")
    monkeypatch.setattr(scans, "_TRAPS", (replace(trap, steps=(0.5, 0.01)),))
    (case,) = scans.cases_of(scan)
    easy, hard = case.run().points
    assert (easy.difficulty, hard.difficulty) == (0.5, 0.01)
    assert 0 < easy.found < hard.found < 1
    assert 0 < easy.expected < hard.expected
    assert easy.error == easy.found / easy.expected


def test_the_settings_of_all_traps_can_be_made():
    for trap in scans._TRAPS:
        assert len({repr(trap.settings(step)) for step in trap.steps}) == len(trap.steps) >= 4


def test_steps_that_a_scan_does_not_allow_are_left_out(scan, monkeypatch):
    monkeypatch.setattr(scans, "_points", lambda path, trap: iter(Point(step, 0, 1, 0) for step in trap.steps))
    cases = {case.name: case for case in scans.cases_of(scan)}
    assert [point.difficulty for point in cases["views"].run().points] == [5, 3]  # of nine views
    assert [point.difficulty for point in cases["dose"].run().points] == [0.3, 0.1, 0.01, 1e-3, 1e-4]


def test_an_interrupted_run_keeps_what_is_finished(tmp_path):
    def interrupted():
        yield Point(1, 0, 0, 0)
        raise KeyboardInterrupt

    cases = [NAMED["wide"], Case("last", "what", "difficulty", "error", 1.0, interrupted)]
    with pytest.raises(KeyboardInterrupt):
        run_cases(cases, tmp_path / "report", command="recon stress")
    assert [record["name"] for record in json.loads((tmp_path / "report" / FILES[1]).read_text())] == ["wide"]


def test_the_report_of_one_case(tmp_path):
    words = ["stress", "--case", "wide", "-q", "-o", str(tmp_path / "report")]
    result = CliRunner().invoke(recon, words)
    assert result.exit_code == 0, result.output
    assert sorted(path.name for path in (tmp_path / "report").iterdir()) == sorted(FILES)
    assert [record["name"] for record in json.loads((tmp_path / "report" / FILES[1]).read_text())] == ["wide"]
    assert "exists: choose another name" in one_sentence(CliRunner().invoke(recon, words))


def test_cases_are_listed_with_and_without_a_scan(scan):
    alone = CliRunner().invoke(recon, ["stress", "--list"]).output.splitlines()
    together = CliRunner().invoke(recon, ["stress", str(scan), "--list"]).output.splitlines()
    assert len(alone) == len(CASES)
    assert len(together) == len(CASES) + len(scans._TRAPS)  # each allows some step
    assert "views" in {line.split()[0] for line in together}
    assert len({line.split()[0] for line in together}) == len(together)


def test_what_cannot_be_compared_is_one_sentence(scan, tmp_path):
    assert "choose from needles" in one_sentence(CliRunner().invoke(recon, ["stress", "--case", "views"]))
    alone = tmp_path / "alone.h5"
    shutil.copy(scan, alone)
    with h5py.File(alone, "a") as file:
        del file["truth"]
    assert "has no truth of all its basis functions" in one_sentence(CliRunner().invoke(recon, ["stress", str(alone)]))
