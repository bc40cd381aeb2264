"""``recon compare``: processes, folders, reruns, requirements, and sentences for what cannot be."""

import json
import sys

import numpy as np
import pytest
from click.testing import CliRunner
from support.tiny_scans import make, one_sentence

from phantomgen.dataset.reader import open_dataset
from phantomgen.dataset.truth import read_truth
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


@pytest.fixture(scope="module")
def others(scan, tmp_path_factory):
    """A comparison with finished volumes and commands of other programs."""
    folder = tmp_path_factory.mktemp("others")
    truth = read_truth(scan)
    with open_dataset(scan) as dataset:
        row = dataset.spectra.basis.evaluate(np.array([60.0]))[:, 0]
        channels = np.einsum(
            "bc,bzyx->czyx", dataset.spectra.basis.evaluate(dataset.spectra.effective_energy), truth.volumes
        )
    np.save(folder / "all.npy", 1.02 * truth.volumes)
    np.save(folder / "mono.npy", 1.05 * np.tensordot(row, truth.volumes, axes=1))
    np.save(folder / "channels.npy", 1.05 * channels)
    (folder / "mine.py").write_text(
        "import sys, time\nimport numpy as np\ntime.sleep(float(sys.argv[3]))\n"
        "np.save(sys.argv[2], np.full((16, 16, 16), 0.01))\n"
    )
    at_60 = "as=mono:60 units=1/mm axes=zyx same-grid"
    names = "basis:photoelectric,compton,kedge_63.3"
    options = [
        *("--methods", "fdk", "--budget", "2s,60s", "--threads", "1", "--require", "near"),
        *("--with", f"near={folder / 'all.npy'} as={names} units=1/mm axes=zyx same-grid"),
        *("--with", f"at-60={folder / 'mono.npy'} {at_60}"),
        *("--with", f"each={folder / 'channels.npy'} as=channel:0,1,2,3 units=1/mm axes=czyx same-grid"),
        *("--run", f"mine {at_60}: {sys.executable} {folder / 'mine.py'} {{dataset}} {{out}} 0"),
        *("--run", f"slow {at_60}: {sys.executable} {folder / 'mine.py'} {{dataset}} {{out}} 3"),
    ]
    result = compare(scan, *options, "-o", folder / "out", "--json")
    assert result.exit_code == 3, (result.output, result.exception)  # there is no fit of Gaussians to exceed `near`
    return folder, {(r["contender"], r["budget"]): r for r in json.loads(result.stdout)["results"]}, options


def test_volumes_of_other_programs_stand_in_the_same_table(others):
    folder, results, _ = others
    by_scalar = -20 * np.log10(0.02)  # the error is 2 % of the truth
    for name, row in results["near", None]["basis"]["honest"].items():
        assert row["psnr"] == pytest.approx(by_scalar + row["psnr_zero"], abs=1e-3), name
        assert row["psnr"] > results["fdk", 60.0]["basis"]["honest"][name]["psnr"]
    stated = results["at-60", None]["stated"]["honest"]["attenuation_60_keV"]
    assert stated["psnr"] == pytest.approx(-20 * np.log10(0.05) + stated["psnr_zero"], abs=1e-3)
    assert results["fdk", 60.0]["stated"]["honest"]["attenuation_60_keV"]["psnr"] < stated["psnr"]
    assert set(results["each", None]["energies"]["honest"]) == set(results["each", None]["views"]["honest"])
    assert results["each", None]["energies"]["honest"]["bin2"]["psnr"] > 35
    page = (folder / "out" / "compare.md").read_text()
    assert "| near " in page
    assert "| at-60 " in page
    assert "## Attenuation at other energies, and densities" in page
    numbers = (folder / "out" / "figures" / "error-against-time.csv").read_text()
    assert "psnr_attenuation_60_keV" in numbers
    assert (folder / "out" / "compare.csv").read_text().count("near,,,basis,honest") == 15  # five scores of three bases


def test_commands_have_the_same_budgets_and_are_measured(others):
    _, results, _ = others
    assert results["mine", 2.0]["seconds"] < 2
    assert results["mine", 60.0]["peak_memory_mib"] is None or 10 < results["mine", 60.0]["peak_memory_mib"] < 150
    assert results["slow", 2.0]["error"] == "nothing is ready within 2 s: the command did not end"
    assert 3 < results["slow", 60.0]["seconds"] < 60
    same = [results[who, 60.0]["stated"]["honest"]["attenuation_60_keV"]["psnr"] for who in ("mine", "slow")]
    assert same[0] == same[1]


@pytest.mark.slow
def test_what_was_run_is_not_run_again_and_a_finished_volume_is_read_anew(scan, others):
    folder, _, options = others
    np.save(folder / "mono.npy", np.zeros((16, 16, 16)))
    result = compare(scan, *options, "-o", folder / "out", "--resume")
    assert result.exit_code == 3
    for name in ("fdk", "mine", "slow"):
        assert f"{name}: done before" in result.stderr
    assert "near cannot" not in result.stderr
    found = read_result(folder / "out" / "results" / "at-60", None)
    assert found["stated"]["honest"]["attenuation_60_keV"]["psnr"] == pytest.approx(
        found["stated"]["honest"]["attenuation_60_keV"]["psnr_zero"]
    )


@pytest.mark.parametrize(
    ("option", "text", "words"),
    [
        ("--with", "a=none.npy as=mono:60", "a: none.npy: there is no such file"),
        (
            "--with",
            "a={volume} as=mono:60",
            "a: {volume} does not say all that a score needs: state --axes, --voxel-mm, ",
        ),
        ("--with", "fdk={volume} as=mono:60", "fdk is the name of a method"),
        (
            "--with",
            "a={volume} as=basis:calcium units=1/mm axes=zyx same-grid",
            "a: the dataset has no basis 'calcium'",
        ),
        ("--run", "a as=mono:60: python x.py {dataset} {out}", "a: its output does not say all that a score needs"),
        ("--run", "a: python x.py", "--run takes"),
    ],
)
def test_statements_are_checked_before_any_work(scan, tmp_path, option, text, words):
    np.save(tmp_path / "v.npy", np.zeros((16, 16, 16)))
    text, words = (each.replace("{volume}", str(tmp_path / "v.npy")) for each in (text, words))
    assert words in one_sentence(compare(scan, "--methods", "fdk", option, text, "-o", tmp_path / "out"))
    assert [path.name for path in tmp_path.iterdir()] == ["v.npy"]
