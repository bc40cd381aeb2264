"""``recon suite``: scores of volumes, commands and methods on a suite, their table, and what is refused."""

import json
import shutil
import sys

import numpy as np
import pytest
from click.testing import CliRunner
from support.edited_datasets import edited_dataset
from support.tiny_scans import one_sentence
from support.tiny_suite import make_tiny

from phantomgen.dataset.truth import read_truth
from recon.cli.main import main as recon
from spectra.threads import set_threads

STATED = "as=basis units=1/mm axes=czyx same-grid"
SCRIPT = """\
import sys
import numpy as np
import phantomgen
with phantomgen.open(sys.argv[1]) as dataset:
    shape = (len(dataset.spectra.basis.names), *dataset.grid.shape)
np.save(sys.argv[2], np.zeros(shape, np.float32))
"""


@pytest.fixture(scope="module", autouse=True)
def _all_threads_again():
    yield
    set_threads(None)


def run(*arguments):
    return CliRunner().invoke(recon, ["suite", *map(str, arguments)])


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("suite")
    return make_tiny(folder / "made", folder / "definitions")


@pytest.fixture
def scans(made, tmp_path):
    """A copy that a test may spoil."""
    return shutil.copytree(made, tmp_path / "scans")


@pytest.fixture(scope="module")
def volumes(made, tmp_path_factory):
    """The truth, a tenth too small, of both cases."""
    folder = tmp_path_factory.mktemp("volumes")
    for case in ("plain", "misstated"):
        np.save(folder / f"{case}.npy", 0.9 * read_truth(made / f"{case}.h5").volumes)
    return folder


@pytest.fixture(scope="module")
def scored(made, volumes, tmp_path_factory):
    """Scores of volumes of both cases, and of a folder that lacks one."""
    folder = tmp_path_factory.mktemp("scored")
    (folder / "some").mkdir()
    shutil.copy(volumes / "plain.npy", folder / "some")
    both = [
        word
        for name, place in (("tenth", volumes), ("some", folder / "some"))
        for word in ("--volumes", f"{name}={place} {STATED}")
    ]
    return folder / "out", run("score", made, *both, "-o", folder / "out")


def mean_psnr(truth: np.ndarray, volumes: np.ndarray) -> float:
    """Mean over the basis functions of 10 log10(max(truth)^2 / MSE)."""
    errors = np.square(truth.astype(np.float64) - volumes).mean(axis=(1, 2, 3))
    return float(np.mean(10 * np.log10(truth.max(axis=(1, 2, 3)).astype(np.float64) ** 2 / errors)))


def test_volumes_of_a_folder_get_the_scores_of_the_formula(made, volumes, scored):
    out, result = scored
    assert result.exit_code == 0, result.output
    rows = json.loads((out / "suite-score.json").read_text())["rows"]
    found = [(row["case"], row["method"]) for row in rows]
    assert found == [("plain", "tenth"), ("plain", "some"), ("misstated", "tenth"), ("misstated", "some")]
    truth = read_truth(made / "plain.h5").volumes
    expected = mean_psnr(truth, np.load(volumes / "plain.npy"))
    for row in rows[:3]:  # both cases have the same truth
        assert row["mean_psnr"] == pytest.approx(expected, abs=1e-3)
        assert row["rmse"]["compton"] == pytest.approx(0.1 * np.sqrt(np.square(truth[1]).mean()), rel=1e-4)
        assert row["views_psnr"] > 20
    table = [[cell.strip() for cell in line.split("|")[1:-1]] for line in result.stdout.splitlines() if "| " in line]
    assert ["method", "plain", "misstated", "mean"] in table
    assert ["tenth", *[f"{expected:.2f}"] * 3] in table
    assert ["some", f"{expected:.2f}", "-", "-"] in table
    assert "- some: there is no volume of this case." in result.stdout
    names = {path.name for path in out.iterdir()}
    assert names == {"cases", "suite-score.json", "suite-score.csv", "suite-score.md", "suite-score.png"}


@pytest.mark.slow
def test_quiet_scoring_says_nothing_on_the_way(made, scored):
    assert "plain: the object as it is" in scored[1].stderr
    again = run(
        "score", made, "--volumes", f"tenth={scored[0].parent / 'some'} {STATED}", "-o", scored[0], "--resume", "-q"
    )
    assert (again.exit_code, again.stderr) == (0, "")


def test_results_name_the_hashes_of_the_scans(made, scored):
    results = json.loads((scored[0] / "suite-score.json").read_text())
    manifest = json.loads((made / "suite.json").read_text())
    assert [results[key] for key in ("suite", "tier", "sha256")] == ["tiny", "minutes", manifest["sha256"]]
    for case in manifest["cases"]:
        scan = results["submissions"][0]["scans"][case["name"]]
        assert scan["arrays"] == {name: array["sha256"] for name, array in case["arrays"].items()}


@pytest.mark.slow
def test_a_command_and_a_method_stand_beside_each_other(made, tmp_path):
    (tmp_path / "mine.py").write_text(SCRIPT)
    command = f"mine {STATED}: {sys.executable} {tmp_path / 'mine.py'} {{dataset}} {{out}}"
    options = ("--run", command, "--methods", "fdk", "--clock", "cpu", "--threads", "1", "-o", tmp_path / "out")
    result = run("score", made, *options, "--json")
    assert result.exit_code == 0, result.output
    assert result.stderr == ""
    rows = json.loads(result.stdout)["rows"]
    assert [(row["case"], row["method"]) for row in rows] == [
        (case, method) for case in ("plain", "misstated") for method in ("fdk", "mine")
    ]
    assert not [row["error"] for row in rows if "error" in row]
    truth = read_truth(made / "plain.h5").volumes
    zero = mean_psnr(truth, np.zeros_like(truth))
    for row in rows:
        assert (row["mean_psnr"] == pytest.approx(zero, abs=1e-3)) == (row["method"] == "mine")
        assert 0 < row["seconds"] < 60


def test_submissions_are_merged_to_one_table(scored, tmp_path):
    shutil.copytree(scored[0], tmp_path / "other")
    results = json.loads((tmp_path / "other" / "suite-score.json").read_text())
    results["submissions"][0]["label"] = "other"
    (tmp_path / "other" / "suite-score.json").write_text(json.dumps(results))
    result = run("table", scored[0], tmp_path / "other" / "suite-score.json", "-o", tmp_path / "both")
    assert result.exit_code == 0, result.output
    assert "| tenth [out] " in result.stdout
    assert "| tenth [other] " in result.stdout
    assert "- other: scored by spectral-ct" in result.stdout
    read = run("table", tmp_path / "both", "--json")
    assert len(json.loads(read.stdout)["submissions"]) == 2
    again = one_sentence(run("table", scored[0], "-o", tmp_path / "both"))
    assert "exists: choose another name by --out, or add --overwrite" in again
    assert "not a folder that recon suite table wrote" in one_sentence(
        run("table", scored[0], "-o", tmp_path / "other", "--overwrite")
    )


def test_a_missing_scan_is_refused(scans):
    (scans / "plain.h5").unlink()
    assert "plain.h5 is missing: `phantomgen suite` with --resume makes it" in one_sentence(run("score", scans))


def test_a_damaged_scan_is_refused(scans):
    content = bytearray((scans / "plain.h5").read_bytes())
    content[len(content) // 2] ^= 4
    (scans / "plain.h5").write_bytes(content)
    assert "plain.h5" in one_sentence(run("score", scans))


@pytest.mark.parametrize(
    ("array", "what"),
    [
        ("/entry/instrument/detector/data", "counts"),
        ("/entry/spectra/source", "stated_spectra"),
        ("/entry/geometry/source", "stated_poses"),
        ("/truth/basis/data", "truth_basis"),
    ],
)
def test_a_changed_scan_is_refused_by_its_hash(scans, array, what):
    with edited_dataset(scans / "plain.h5") as file:
        values = file[array][()]
        values.flat[values.size // 2] += 1
        file[array][...] = values
    sentence = one_sentence(run("score", scans))
    assert f"plain.h5 changed since it was made: {what} have other hashes" in sentence


def test_another_scan_under_the_name_of_a_case_is_refused(scans):
    shutil.copy(scans / "misstated.h5", scans / "plain.h5")
    assert "plain.h5 changed since it was made: stated_spectra" in one_sentence(run("score", scans))


def test_a_scan_that_is_not_the_stored_one_is_refused(scans):
    manifest = json.loads((scans / "suite.json").read_text())
    manifest["cases"][0] |= {"agreement": "different", "why": "counts have another shape"}
    (scans / "suite.json").write_text(json.dumps(manifest))
    assert "plain.h5 is not the scan of the suite tiny: counts have another shape" in one_sentence(run("score", scans))


@pytest.mark.parametrize("text", ["{", "[]", '{"schema": "spectral-ct-suite"}', '{"schema": "other", "cases": []}'])
def test_a_damaged_list_of_scans_is_refused(scans, text):
    (scans / "suite.json").write_text(text)
    assert "suite.json is no list of a suite's scans: make it anew" in one_sentence(run("score", scans))


def test_foreign_volumes_are_refused_before_anything_is_written(made, volumes, tmp_path):
    def refused(folder, stated=STATED) -> str:
        return one_sentence(run("score", made, "--volumes", f"mine={folder} {stated}", "-o", tmp_path / "out"))

    assert "is no folder: give one with a file per case" in refused(tmp_path / "none")
    foreign = tmp_path / "foreign"
    foreign.mkdir()
    assert "has no file that is named after a case: plain, misstated" in refused(foreign)
    np.save(foreign / "plain.npy", np.zeros((3, 8, 8, 8), np.float32))
    assert "plain: " in refused(foreign)
    np.save(foreign / "plain.npy", np.zeros((2, 16, 16, 16), np.float32))
    assert "plain: " in refused(foreign)
    np.savez(foreign / "plain.npz", a=np.zeros(3))
    assert "has several volumes of plain: plain.npy, plain.npz" in refused(foreign)
    assert "axes" in refused(volumes, "as=basis units=1/mm same-grid")
    assert not (tmp_path / "out").exists()


def test_other_folders_are_refused(made, scored, tmp_path):
    assert "has no suite.json: `phantomgen suite v1 -o" in one_sentence(run("score", tmp_path))
    assert "there is no method 'magic'" in one_sentence(run("score", made, "--methods", "magic"))
    assert "exists: add --resume to score what is missing" in one_sentence(run("score", made, "-o", scored[0]))
    (tmp_path / "mine").mkdir()
    assert "not a folder that recon suite score wrote" in one_sentence(
        run("score", made, "-o", tmp_path / "mine", "--overwrite")
    )
    assert "there is no" in one_sentence(run("table", tmp_path / "mine"))
