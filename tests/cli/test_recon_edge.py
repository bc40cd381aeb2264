"""The command ``recon edge`` and the choice of bases: whole scans at toy size, seen through ``/entry`` only."""

import json

import pytest
from click.testing import CliRunner
from support.edited_datasets import edited_dataset
from support.tiny_scans import make, one_sentence

from phantomgen.dataset.reader import open_dataset
from recon.cli.main import main as recon
from recon.kedge.choose_basis import choose_basis, find_edges
from spectra.basis.basis import Basis, BasisFunction

LAID = "panel={rows: 48, columns: 48, pitch: 4.2}"
PLAIN = "objects=[{type: cylinder, material: soft_tissue, radius: 50, length: 100}]"


@pytest.fixture(scope="module")
def scan(tmp_path_factory):
    path = tmp_path_factory.mktemp("edge") / "scan.h5"
    return make(path, "--views", "12", "--test-views", "1", "--set", LAID)


@pytest.fixture(scope="module")
def gadolinium(tmp_path_factory):
    """Gadolinium in blood, by its composition; the file knows no K edge."""
    path = tmp_path_factory.mktemp("edge") / "gadolinium.h5"
    settings = (
        "basis=[{type: photoelectric}, {type: compton}]",
        "materials={tissue: {composition: muscle}, vessel: {solution: {solvent: blood, solutes: {Gd: 5}}}}",
        "objects=[{type: cylinder, material: tissue, radius: 50, length: 100}, "
        "{type: cylinder, material: vessel, radius: 35, length: 100}]",
        "detector.thresholds=[20, 35, 50.3, 65, 80]",
    )
    return make(path, "--views", "8", "--test-views", "1", "--set", LAID, *(a for s in settings for a in ("--set", s)))


@pytest.fixture(scope="module")
def weak(tmp_path_factory):
    """A K edge in all of the object, 1/250 of the strongest one of the preset."""
    path = tmp_path_factory.mktemp("edge") / "weak.h5"
    faint = "materials.soft_tissue.coefficients={photoelectric: 0.0015, compton: 0.0188, kedge_63.3: 0.0001}"
    return make(path, "--views", "12", "--test-views", "1", "--set", LAID, "--set", PLAIN, "--set", faint)


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    path = tmp_path_factory.mktemp("edge") / "plain.h5"
    return make(path, "--views", "4", "--test-views", "1", "--set", LAID, "--set", PLAIN)


def test_the_edge_is_found_without_the_truth_and_whatever_the_file_says(scan, tmp_path):
    with edited_dataset(scan) as file:
        del file["truth"]
        file["entry/spectra/edge_energy"][2] = 40.0
    result = CliRunner().invoke(recon, ["edge", str(scan), "-o", str(tmp_path / "found"), "--json"])
    with edited_dataset(scan) as file:
        file["entry/spectra/edge_energy"][2] = 63.3
    assert result.exit_code == 0, result.output
    record = json.loads(result.output)
    assert record["edges"][0]["found_keV"] == pytest.approx(63.3, abs=1.0)
    assert record["edges"][0]["name"].startswith("kedge_63")
    assert {path.suffix for path in tmp_path.iterdir()} == {".json", ".png", ".csv"}


def test_an_edge_near_that_of_the_file_keeps_its_name(scan):
    with open_dataset(scan) as dataset:
        choice = choose_basis(dataset, 3, ())
    assert choice.basis.names == ("photoelectric", "compton", "kedge_63.3")
    assert choice.basis.functions[2].edge_energy == choice.profiles[0][1].best


def test_the_file_s_function_is_taken_where_it_is_needed(scan):
    with open_dataset(scan) as dataset:
        choice = choose_basis(dataset)
        assert choice.basis == dataset.spectra.basis
        assert choice.judgements[0].warranted
        assert len(choose_basis(dataset, 2).basis) == 2


def test_no_edge_is_invented(plain):
    with open_dataset(plain) as dataset:
        assert choose_basis(dataset, None, ()).basis.names == ("photoelectric", "compton")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("edge",), "no K edge shows in"),
        (("edge", "--edge", "x"), "--edge takes auto, or energies in keV"),
        (("fit", "--bases", "3", "-q"), "no K edge shows in"),
        (("edge", "--edge", "33,50"), "at least 5, not 4"),
        (("edge", "--edge", "500"), "a K edge at 500 keV cannot be seen"),
    ],
)
def test_what_cannot_be_is_refused_in_one_sentence(plain, tmp_path, arguments, words):
    command, *rest = arguments
    result = CliRunner().invoke(recon, [command, str(plain), "-o", str(tmp_path / "out"), *rest])
    assert words in one_sentence(result)
    assert not list(tmp_path.glob("out*"))


def test_an_edge_where_there_is_one_is_found_by_asking_for_three_bases(scan, tmp_path):
    with open_dataset(scan) as dataset:
        two = dataset.with_basis(type(dataset.spectra.basis)(dataset.spectra.basis.functions[:2]))
        assert choose_basis(two, 3).basis.functions[2].edge_energy == pytest.approx(63.3, abs=1.0)
        assert find_edges(two).basis == find_edges(dataset.with_basis(two.spectra.basis)).basis


def test_gadolinium_is_named_where_the_file_knows_no_edge(gadolinium):
    with open_dataset(gadolinium) as dataset:
        choice = find_edges(dataset)
    assert choice.basis.names == ("photoelectric", "compton", "kedge_Gd")
    assert choice.record()["edges"][0]["element"] == "Gd"
    assert choice.record()["edges"][0]["found_keV"] == pytest.approx(50.24, abs=0.01)
    assert "K edge at 50.24 keV (Gd)" in choice.sentences[-1]


def test_a_weak_edge_is_kept(weak):
    """Most of its drop in deviance is below the model error that a fit concedes, and far above noise."""
    with open_dataset(weak) as dataset:
        choice = choose_basis(dataset)
        assert choice.basis == dataset.spectra.basis
    assert choice.judgements[0].noise < choice.judgements[0].saved < 0.5


def test_an_edge_that_is_not_there_is_not_agreed_on(plain):
    with open_dataset(plain) as dataset:
        stated = dataset.spectra.basis
        functions = (*stated.functions[:2], BasisFunction("step", edge_energy=63.3))
        choice = choose_basis(dataset.with_basis(Basis(functions, stated.reference_energy)))
    assert choice.basis.names == ("photoelectric", "compton")
    assert "neighbours among" in choice.judgements[0].reason
