"""`recon calibrate`, and `recon fit --spectrum` with what it wrote."""

import json

import numpy as np
import pytest
import yaml
from click.testing import CliRunner

from phantomgen.dataset.reader import open_dataset
from recon.calibration.refine import ChosenSpectrum
from recon.calibration.spectrum_file import read_spectrum, with_sensitivities
from recon.cli.main import main as recon
from recon.runs.interfaces import Unwatched
from recon.uncertainty.estimate import estimate
from spectra.detector.detector import Detector
from spectra.errors import InputError
from spectra.materials.material import Material
from spectra.source.source import Filter, Source
from tests.support.tiny_scans import make, one_sentence

TRUE = {"voltage": 138.0, "filter": 2.9, "threshold_1": 44.2, "threshold_2": 63.3, "threshold_3": 80.9}
WEDGE = {
    "version": 1,
    "source": {"voltage": 140, "filter": {"composition": "Al", "thickness": 2.5}},
    "detector": {"thresholds": [20, 45, 63.3, 80], "composition": "CdTe", "thickness": 1.6},
    "materials": {"PMMA": {"composition": "C5H8O2", "density": 1.18}},
    "table": "wedge.csv",
}


def run(*arguments):
    return CliRunner().invoke(recon, ["calibrate", *map(str, arguments)])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A wedge of aluminium, copper and PMMA, counted in the hard thresholds of a tube of 138 kV."""
    source = Source.tube(138.0, None, 12.0, (Filter(Material("Al", None, "Al"), 2.9),))
    detector = Detector.photon_counting([20.6, 44.2, 63.3, 80.9], 138.0)
    energies, photons = source.sampled(source.grid(20.0, 3000, detector.breaks))
    weights = photons * detector.response(energies)
    weights *= 4e6 / weights.sum()
    absorbers = {"Al": (2, 5, 10, 20, 40), "Cu": (0.2, 0.5, 1, 2, 4), "PMMA": (20, 50, 100, 200)}
    rng, rows = np.random.default_rng(1), ["material,thickness,bin0,bin1,bin2,bin3"]
    for name, lengths in {"": (0,), **absorbers}.items():
        for length in lengths:
            material = Material("PMMA", 1.18, "C5H8O2") if name == "PMMA" else Material("Al", None, name or "Al")
            passed = np.exp(-length * material.attenuation(energies.nodes))
            rows.append(f"{name},{length:g}," + ",".join(map(str, rng.poisson(weights @ passed))))
    path = tmp_path_factory.mktemp("wedge")
    (path / "wedge.csv").write_text("\n".join([*rows, ""]), encoding="utf-8")
    (path / "wedge.yaml").write_text(yaml.safe_dump(WEDGE), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def calibrated(folder):
    out = folder / "calibrated.yaml"
    result = run(folder / "wedge.yaml", "-o", out, "--json")
    assert result.exit_code == 0, result.output
    return out, json.loads(result.stdout)


def test_values_lie_within_their_uncertainties(calibrated):
    found = calibrated[1]["parameters"]
    for name, true in TRUE.items():
        assert abs(found[name]["value"] - true) < 3.5 * found[name]["uncertainty"], name
    assert calibrated[1]["deviance"] < 2 * calibrated[1]["degrees_of_freedom"]


def test_a_fit_takes_the_sensitivities(calibrated, tmp_path):
    scan = make(tmp_path / "scan.h5", "--set", "geometry.views=12")
    with open_dataset(scan) as dataset:
        other = with_sensitivities(dataset, read_spectrum(calibrated[0]))
        assert other.spectra.lower == pytest.approx([20.7, 44.2, 63.3, 80.9], abs=0.5)
        assert other.spectra.weights.sum() == pytest.approx(dataset.spectra.weights.sum())
        np.testing.assert_allclose(other.spectra.basis_values, dataset.spectra.basis.evaluate(other.spectra.energy))
    runs = []
    for name, more in (("plain", []), ("calibrated", ["--spectrum", str(calibrated[0])])):
        command = ["fit", str(scan), "-o", str(tmp_path / name), "--method", "fdk", "--no-figures", "-q", "--json"]
        result = CliRunner().invoke(recon, [*command, *more])
        assert result.exit_code == 0, result.output
        runs.append(json.loads(result.stdout))
    errors = [[scores["rmse"] for scores in each["basis"].values()] for each in runs]
    assert all(abs(one / other - 1) > 1e-4 for one, other in zip(*errors, strict=True))
    with open_dataset(scan) as dataset:  # what later commands take for these runs
        used = [
            ChosenSpectrum.of_run(dataset, tmp_path / name).dataset.spectra.lower for name in ("plain", "calibrated")
        ]
        assert used[0] == pytest.approx(dataset.spectra.lower)
        assert used[1] == pytest.approx(other.spectra.lower)
        assert estimate(tmp_path / "calibrated", dataset, 2, 0, Unwatched()).spread.deviation.any()


def test_warning_and_prior(folder, tmp_path):
    result = run(folder / "wedge.yaml", "--free", "voltage", "--prior", "voltage=1", "-o", tmp_path / "x.yaml")
    assert result.exit_code == 0, result.output
    assert "does not explain the counts" in result.stderr
    assert yaml.safe_load((tmp_path / "x.yaml").read_text(encoding="utf-8"))["parameters"]["voltage"]["prior"] == 1


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"sorce": 1}, "sorce - unknown key"),
        ({"source": {**WEDGE["source"], "voltage": -3}}, "source.voltage - input should be greater than 0, got -3"),
        (
            {"table": None, "steps": [{"lengths": {"C5H8O2": 2}, "counts": [1] * 4}]},
            "'C5H8O2' needs an entry in 'materials'",
        ),
        ({"steps": [{"counts": [1, 2, 3, 4]}]}, "either a table"),
        ({"prior": {"resolution": 1}}, "prior.resolution has no use"),
        ({"open_beam": [1e6] * 4}, "a value is above 1.2"),
        ({"table": "no.csv"}, "no.csv cannot be read"),
        ({"detector": {"thresholds": [20, 45]}}, "has 4 counts for 2 thresholds"),
    ],
)
def test_bad_files_get_one_sentence(folder, change, sentence):
    (folder / "bad.yaml").write_text(yaml.safe_dump({**WEDGE, **change}), encoding="utf-8")
    assert sentence in one_sentence(run(folder / "bad.yaml", "-o", folder / "none.yaml"))
    assert not (folder / "none.yaml").exists()


def test_transmissions_are_counts_over_the_open_beam(folder, tmp_path, calibrated):
    rows = [line.split(",") for line in (folder / "wedge.csv").read_text(encoding="utf-8").splitlines()]
    air = [float(cell) for cell in rows[1][2:]]
    steps = [
        {"lengths": {row[0]: float(row[1])}, "counts": [float(c) / a for c, a in zip(row[2:], air, strict=True)]}
        for row in rows[2:]
    ]
    content = {**WEDGE, "steps": steps, "open_beam": air}
    del content["table"]
    (tmp_path / "t.yaml").write_text(yaml.safe_dump(content), encoding="utf-8")
    result = run(tmp_path / "t.yaml", "-o", tmp_path / "o.yaml", "--json")
    assert result.exit_code == 0, result.output
    for name, found in json.loads(result.stdout)["parameters"].items():
        assert found["value"] == pytest.approx(calibrated[1]["parameters"][name]["value"], rel=1e-6)


def test_other_files_are_no_spectra_and_are_not_replaced(folder, calibrated, tmp_path):
    with pytest.raises(InputError, match="holds no channel sensitivities"):
        read_spectrum(folder / "wedge.yaml")
    text = one_sentence(run(folder / "wedge.yaml", "-o", folder / "wedge.yaml", "--overwrite"))
    assert "it will not be replaced" in text
    content = yaml.safe_load(calibrated[0].read_text(encoding="utf-8"))
    del content["spectra"]["source"]
    (tmp_path / "cut.yaml").write_text(yaml.safe_dump(content), encoding="utf-8")
    with pytest.raises(InputError, match=r"spectra\.source is missing"):
        read_spectrum(tmp_path / "cut.yaml")


def test_a_fit_refines_its_spectrum(tmp_path):
    scan = make(tmp_path / "scan.h5", "--set", "geometry.views=12", rows=64, columns=64)
    command = ["fit", str(scan), "-o", str(tmp_path / "run"), "--method", "fdk", "--no-figures"]
    result = CliRunner().invoke(recon, [*command, "--refine", "spectrum+air", "--prior", "voltage=1"])
    assert result.exit_code == 0, result.output
    assert "Refined the spectrum on" in result.stderr
    content = yaml.safe_load((tmp_path / "run" / "spectrum.yaml").read_text(encoding="utf-8"))
    assert content["errors"]["voltage"]["prior"] == 1
    assert len(read_spectrum(tmp_path / "run" / "spectrum.yaml").response) == 4
    result = CliRunner().invoke(recon, [*command, "--prior", "voltage=1", "--overwrite"])
    assert result.exit_code == 2
    assert "add --refine" in result.stderr
