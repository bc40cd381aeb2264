"""``recon compare``: processes, folders, reruns, requirements, and sentences for what cannot be."""

import json

import pytest
from click.testing import CliRunner
from support.tiny_scans import make, one_sentence

from recon.cli.main import main as recon
from recon.comparison.job import read_result, write_result
from spectra.threads import set_threads


@pytest.fixture(scope="module", autouse=True)
def _all_threads_again():
    yield
    set_threads(None)


@pytest.fixture(scope="module")
def scan(tmp_path_factory):
    path = tmp_path_factory.mktemp("data") / "tiny.h5"
    return make(path, "--set", "geometry.views=12", "--set", "geometry.test_views=2")


def compare(*arguments):
    return CliRunner().invoke(recon, ["compare", *map(str, arguments)])


@pytest.fixture(scope="module")
def made(scan, tmp_path_factory):
    """A comparison in which one method cannot take part."""
    folder = tmp_path_factory.mktemp("made") / "out"
    options = ("--methods", "one-step+image,fdk", "--budget", "1m", "--clock", "cpu", "--threads", "1")
    return folder, compare(scan, *options, "-o", folder), options


def test_a_failure_does_not_stop_the_others(made):
    folder, result, _ = made
    assert result.exit_code == 0, result.output
    assert "leave --pipeline image out" in result.stderr
    assert "fdk: 60 s ..." in result.stderr
    assert "| fdk, 60 s" in result.stdout
    assert {p.name for p in folder.iterdir()} >= {"compare.json", "compare.csv", "compare.md", "figures", "results"}
    assert (folder / "figures" / "error-against-time.png").is_file()
    content = json.loads((folder / "compare.json").read_text())
    assert [r["contender"] for r in content["results"]] == ["one-step+image", "fdk"]
    assert content["results"][1]["energies"]["paper"]["bin0"]["psnr"] > 10


def test_a_rerun_does_only_what_is_missing(scan, made):
    folder, _, options = made
    kept = read_result(folder / "results" / "fdk", 60.0) | {"seconds": 59.25}
    write_result(folder / "results" / "fdk", 60.0, kept)
    result = compare(scan, *options, "-o", folder, "--resume", "--protocol", "r2", "--json", "--require", "fdk")
    assert result.exit_code == 3
    content = json.loads(result.stdout)
    assert content["results"][1]["seconds"] == 59.25
    assert content["failed"] == ["gaussian cannot be compared with fdk at 60 s: gaussian has no score."]


def test_a_process_that_dies_leaves_its_last_words(scan, tmp_path, monkeypatch):
    monkeypatch.setattr("recon.comparison.campaign.sys.executable", "false")
    result = compare(scan, "--methods", "fdk", "-o", tmp_path / "out", "--json")
    assert result.exit_code == 0
    assert json.loads(result.stdout)["results"][0]["error"] == "the process ended with status 1: no message"


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (("--methods", "magic"), "there is no method 'magic' to compare"),
        (("--budget", "soon"), "--budget takes times above 0 such as 60s,240s, got 'soon'"),
        (("--protocol", "best"), "there is no metric protocol 'best'"),
        (("--study", "colours"), "there is no study 'colours': choose from views-and-volumes, basis,"),
        (("--require", "magic"), "there is no method 'magic' to compare"),
    ],
)
def test_what_cannot_be_is_one_sentence(scan, tmp_path, options, sentence):
    assert sentence in one_sentence(compare(scan, *options, "-o", tmp_path / "out"))
    assert list(tmp_path.iterdir()) == []


def test_methods_and_study_exclude_each_other(scan):
    assert compare(scan, "--methods", "fdk", "--study", "basis").exit_code == 2


def test_a_folder_that_exists_is_kept(scan, made, tmp_path):
    folder, _, options = made
    assert (
        "exists: add --resume to run what is missing, choose another name by --out, or add --overwrite"
        in one_sentence(compare(scan, *options, "-o", folder))
    )
    changed = (*options[:-1], "2")
    assert "was begun with another threads" in one_sentence(compare(scan, *changed, "-o", folder, "--resume"))
    (tmp_path / "mine").mkdir()
    assert "not a folder that recon compare wrote" in one_sentence(
        compare(scan, "--overwrite", "-o", tmp_path / "mine")
    )
    assert "does not exist" in one_sentence(compare(scan, "-o", tmp_path / "no" / "out"))
