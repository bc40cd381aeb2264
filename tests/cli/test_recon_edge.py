"""The command ``recon edge`` and the choice of bases: whole scans at toy size, seen through ``/entry`` only."""

import json

import h5py
import pytest
from click.testing import CliRunner
from tiny_scans import make, one_sentence

from phantomgen.dataset import open_dataset
from recon.basis_choice import choose_basis, find_edges
from recon.cli import main as recon

LAID = "panel={rows: 48, columns: 48, pitch: 4.2}"
PLAIN = "objects=[{type: cylinder, material: soft_tissue, radius: 50, length: 100}]"


@pytest.fixture(scope="module")
def scan(tmp_path_factory):
    path = tmp_path_factory.mktemp("edge") / "scan.h5"
    return make(path, "--views", "4", "--test-views", "1", "--set", LAID)


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    path = tmp_path_factory.mktemp("edge") / "plain.h5"
    return make(path, "--views", "4", "--test-views", "1", "--set", LAID, "--set", PLAIN)


def test_the_edge_is_found_without_the_truth_and_whatever_the_file_says(scan, tmp_path):
    with h5py.File(scan, "r+") as file:
        del file["truth"]
        file["entry/spectra/edge_energy"][2] = 40.0
    result = CliRunner().invoke(recon, ["edge", str(scan), "-o", str(tmp_path / "found"), "--json"])
    with h5py.File(scan, "r+") as file:
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
