"""``phantomgen suite``: files, hashes, resuming, and how it ends."""

import json
from dataclasses import replace

import numpy as np
import pytest
from support.tiny_scans import one_sentence
from support.tiny_suite import definitions, make_tiny, suite

from phantomgen.dataset.adapters.to_hashes import array_hashes
from phantomgen.dataset.reader import open_dataset
from phantomgen.dataset.truth import read_truth
from phantomgen.suite.definition import read_suite
from phantomgen.suite.run import expected_of, make_suite


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("suite")
    return make_tiny(folder / "made", folder / "definitions")


@pytest.fixture
def known(monkeypatch, tmp_path):
    return definitions(monkeypatch, tmp_path / "definitions")


def test_the_manifest_says_what_the_files_are(made):
    manifest = json.loads((made / "suite.json").read_text())
    assert [manifest[key] for key in ("suite", "tier", "seconds")] == ["tiny", "minutes", 60]
    assert [case["name"] for case in manifest["cases"]] == ["plain", "misstated"]
    assert sorted(path.name for path in made.iterdir()) == ["misstated.h5", "plain.h5", "suite.json"]
    for case in manifest["cases"]:
        assert case["arrays"] == array_hashes(made / case["file"])
        assert case["arrays"]["counts"]["shapes"] == [[10, 4, 32, 32]]
        assert (case["agreement"], case["basis"]) == ("not stored", ["photoelectric", "compton", "kedge_63.3"])


def test_a_wrong_spectrum_is_stated_and_the_counts_and_truth_stay(made):
    with open_dataset(made / "plain.h5") as plain, open_dataset(made / "misstated.h5") as misstated:
        assert np.array_equal(plain.load(), misstated.load())
        right, wrong = (dataset.spectra.effective_energy for dataset in (plain, misstated))
    assert wrong[-1] > right[-1] + 1  # keV; the channel that is open above has the further photons
    truths = [read_truth(made / f"{name}.h5").volumes for name in ("plain", "misstated")]
    assert np.array_equal(*truths)


def test_resuming_makes_only_what_is_missing_and_the_same(made, known):
    before = json.loads((made / "suite.json").read_text())["cases"]
    times = {path.name: path.stat().st_mtime_ns for path in made.iterdir()}
    (made / "misstated.h5").unlink()
    result = suite("tiny", "-o", made, "--resume")
    assert result.exit_code == 0, result.output
    assert (made / "plain.h5").stat().st_mtime_ns == times["plain.h5"]
    after = json.loads((made / "suite.json").read_text())["cases"]
    assert [case["arrays"] for case in after] == [case["arrays"] for case in before]


@pytest.mark.slow
def test_an_interrupted_suite_can_be_resumed(known, tmp_path, monkeypatch):
    def interrupt(*_, **__):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("phantomgen.suite.run.degrade_file", interrupt)
        assert suite("tiny", "-o", tmp_path / "out").exit_code == 130
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["plain.h5", "suite.json"]
    result = suite("tiny", "-o", tmp_path / "out", "--resume", "--json")
    assert result.exit_code == 0, result.output
    assert [case["name"] for case in json.loads(result.stdout)["cases"]] == ["plain", "misstated"]


def test_hashes_are_compared_with_the_stored_ones(made, known):
    stored = expected_of(json.loads((made / "suite.json").read_text()))
    (known / "tiny-expected.json").write_text(json.dumps({"minutes": stored}))
    result = suite("tiny", "-o", made, "--resume")
    assert (result.exit_code, result.stderr.count(": identical")) == (0, 2)
    stored["plain"]["truth"]["compton"][0] *= 2
    stored["plain"]["arrays"]["truth_basis"]["sha256"] = "0"
    (known / "tiny-expected.json").write_text(json.dumps({"minutes": stored}))
    result = suite("tiny", "-o", made, "--resume", "-q")
    assert result.exit_code == 3
    assert result.stderr == (
        "Warning: plain is not the scan that the suite states: sums over the truth changed by up to 5.0e-01 of their "
        "value\n"
    )
    (known / "tiny-expected.json").unlink()
    assert suite("tiny", "-o", made, "--resume", "-q").exit_code == 0


def test_what_cannot_be_is_one_sentence(made, known, tmp_path):
    assert "there is no suite 'v9': choose from tiny" in one_sentence(suite("v9"))
    assert "has no tier 'night'" in one_sentence(suite("tiny", "--tier", "night", "-o", tmp_path / "no"))
    assert "exists: add --resume to make what is missing" in one_sentence(suite("tiny", "-o", made))
    other = one_sentence(suite("tiny", "--tier", "hour", "-o", made, "--resume"))
    assert "holds the suite tiny, tier minutes" in other
    (tmp_path / "mine").mkdir()
    assert "not a folder that phantomgen suite wrote" in one_sentence(
        suite("tiny", "-o", tmp_path / "mine", "--resume")
    )
    assert not (tmp_path / "no").exists()


@pytest.mark.parametrize("case", ["k-edge", "two-agents"])
@pytest.mark.slow
def test_scans_of_v1_are_the_stored_ones(tmp_path, case):
    chosen = read_suite("v1", "minutes")
    one = replace(chosen, cases=tuple(found for found in chosen.cases if found.name == case))
    (entry,) = make_suite(one, tmp_path / "v1", tell=lambda _: None).manifest["cases"]
    assert entry["agreement"] in ("identical", "same within rounding"), entry["why"]
