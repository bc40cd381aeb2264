"""The commands that show the energies of a scene and choose thresholds for them."""

import json

import pytest
from click.testing import CliRunner

from phantomgen.cli.main import main


def run(*arguments: str):
    return CliRunner().invoke(main, [str(a) for a in arguments])


def test_spectrum_says_what_the_beam_is_and_draws_it(tmp_path):
    path = tmp_path / "kedge.png"
    result = run("spectrum", "--preset", "kedge", "--plot", path)
    assert (result.exit_code, result.stderr) == (0, "")
    for words in (
        "mean energy       59.20 keV",
        "4.969 and 7.840 mm Al",
        "bin2         63.3 .. 80",
        "behind 20 cm water",
    ):
        assert words in result.stdout
    assert path.read_bytes().startswith(b"\x89PNG")


def test_spectrum_as_json_has_every_number():
    facts = json.loads(run("spectrum", "--preset", "kedge", "--behind", "10 cm soft_tissue", "--json").stdout)
    assert facts["behind"] == "10 cm soft_tissue"
    assert facts["hvl_mm_Al"][0] < facts["hvl_mm_Al"][1]
    assert facts["homogeneity"] == pytest.approx(facts["hvl_mm_Al"][0] / facts["hvl_mm_Al"][1])
    shares = [channel["share"] for channel in facts["channels"]]
    assert 0.9 < sum(shares) < 1
    assert facts["photons_per_mAs"] * facts["charge_mAs_per_view"] == pytest.approx(facts["photons"])
    assert facts["channels"][0]["counts"] == pytest.approx(shares[0] * 2e5)
    assert facts["condition"]["functions"]["conditioned"] == pytest.approx(1)
    assert facts["condition"]["air"]["raw"] > facts["condition"]["air"]["conditioned"] > 1
    assert all(noise["behind"] > noise["air"] > 0 for noise in facts["noise"])


def test_too_few_channels_are_said_and_not_divided_by_zero():
    result = run("spectrum", "--preset", "kedge", "--set", "detector.thresholds=[20, 63.3]")
    assert result.exit_code == 0
    assert "unbounded" in result.stdout
    assert "2 channels cannot tell 3 basis functions apart: at least 3 are needed." in result.stdout
    few = ("--set", "detector.thresholds=[20]", "--set", "source={type: monochromatic, energy: 60, photons: 1000}")
    facts = json.loads(run("spectrum", "--preset", "kedge", *few, "--json").stdout)
    assert [noise["air"] for noise in facts["noise"]] == [None] * len(facts["noise"])


@pytest.mark.parametrize(
    ("arguments", "code", "expected"),
    [
        (["spectrum"], 2, "name either a scene file or a preset"),
        (["spectrum", "--preset", "kegde"], 1, "did you mean 'kedge'?"),
        (["spectrum", "--preset", "kedge", "--plot", "kedge.bmp"], 1, "a picture ends in .png, .pdf or .svg"),
        (["spectrum", "--preset", "kedge", "--behind", "water"], 1, "such as '20 cm water + 5 mm bone'"),
        (["spectrum", "--preset", "kedge", "--set", "source.kvp=70"], 1, "channel bin3 starts at 80 keV"),
        (["optimize-thresholds", "--preset", "kedge"], 2, "Missing option '--basis'"),
        (["optimize-thresholds", "--basis", "compton"], 2, "name either a scene file or a preset"),
        (["optimize-thresholds", "--preset", "kedge", "--basis", "comptn"], 1, "did you mean 'compton'?"),
    ],
)
def test_bad_input_is_one_sentence(arguments, code, expected, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = run(*arguments)
    assert (result.exit_code, result.stdout) == (code, "")
    assert expected in result.stderr
    assert list(tmp_path.iterdir()) == []


def test_optimize_thresholds_prints_what_to_paste(tmp_path):
    path = tmp_path / "thresholds.png"
    result = run("optimize-thresholds", "--preset", "kedge", "--basis", "kedge_63.3", "--plot", path)
    assert (result.exit_code, result.stderr) == (0, "")
    assert path.read_bytes().startswith(b"\x89PNG")
    setting = result.stdout.splitlines()[-1].split("--set ")[1].strip("'")
    old = run("optimize-thresholds", "--preset", "kedge", "--basis", "kedge_63.3", "--json")
    new = run("optimize-thresholds", "--preset", "kedge", "--basis", "kedge_63.3", "--set", setting, "--json")
    facts, again = json.loads(old.stdout), json.loads(new.stdout)
    assert again["old"]["thresholds_keV"] == facts["new"]["thresholds_keV"] == again["new"]["thresholds_keV"]
    assert again["old"]["bound"] == pytest.approx(facts["new"]["bound"], rel=1e-4)
    assert facts["trace"] == {"kedge_63.3": 0.1}
