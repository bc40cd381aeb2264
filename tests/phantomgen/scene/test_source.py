"""Sources of scene files, and spectra from files beside them."""

import numpy as np
import pytest
from click.testing import CliRunner

from phantomgen.cli.main import main
from phantomgen.scene.file.scene_file import SceneFile
from phantomgen.scene.input_files.spectrum_table import read_source, read_spectrum
from phantomgen.scene.scan import load_scene
from phantomgen.simulation.forward_model.energy_grids import fine_transmission, reconstructor_spectra
from spectra.errors import InputError, SceneError
from spectra.source.source import Source

SCENE = """\
version: 1
name: toy
source: {source}
detector: {{type: photon_counting, thresholds: [20]}}
geometry: {{type: circular, sod: 100, sdd: 200, views: 4}}
panel: {{rows: 6, columns: 8, pitch: 2}}
volume: {{voxels: 4, size: 20}}
materials:
  water: {{composition: H2O, density: 1.0}}
objects:
  - {{type: sphere, material: water, radius: 5}}
"""
TABLE = "type: table, file: tube.csv"
DECLARED = f"{TABLE}, values: per_bin, energies: centres"


def scan_of(source, folder=".", *overrides):
    return load_scene(SceneFile(f"{folder}/toy.yaml", SCENE.format(source="{" + source + "}"), overrides))


def refusal(source, folder="."):
    with pytest.raises(SceneError) as caught:
        scan_of(source, folder)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_lines_come_with_weights_or_photons():
    assert scan_of("type: lines, lines: {59.54: 35.9, 26.34: 2.4}, photons: 1000").source.photons == pytest.approx(1000)
    assert scan_of("type: lines, lines: {59.54: 800, 26.34: 200}").source.photons == pytest.approx(1000)


def test_a_resolved_scene_of_lines_is_the_same_scene():
    file = SceneFile("toy.yaml", SCENE.format(source="{type: lines, lines: {59.54: 35.9, 122: 2}, photons: 10}"))
    assert SceneFile("again.yaml", file.resolved).model == file.model


def test_a_band_is_a_source():
    source = scan_of("type: band, energy: 60, width: 1.2, photons: 5000").source
    assert (source.maximum, source.photons) == (pytest.approx(62.4), pytest.approx(5000))


def test_the_charge_of_a_tube_gives_its_photons_by_the_inverse_square_law():
    fluence = Source.tube(100, None).photons  # per cm^2 and mAs at 1 m
    near = scan_of("type: tube, kvp: 100, mas: 0.5").source.photons
    far = scan_of("type: tube, kvp: 100, mas: 0.5", ".", "geometry.sdd=400").source.photons
    assert near == pytest.approx(fluence * 0.5 * 0.2**2 * 25, rel=1e-9)
    assert far == pytest.approx(near / 4, rel=1e-9)
    needed = scan_of(f"type: tube, kvp: 100, photons: {near}").source_fields["charge"]
    assert needed == (pytest.approx(0.5, rel=1e-9), "mA*s")
    assert "either photons per pixel and view, or mas" in refusal("type: tube, kvp: 100")
    assert "either photons per pixel and view, or mas" in refusal("type: tube, kvp: 100, mas: 1, photons: 2")


@pytest.mark.parametrize("separator", [",", "; ", "\t", " , "])
def test_a_table_lies_beside_the_scene(tmp_path, separator):
    rows = [(30.5, 5.0), (31.5, 10.0), (32.5, 5.0)]
    text = "# energy, photons\n\n" + "".join(f"{e}{separator}{n}\n" for e, n in rows)
    (tmp_path / "tube.csv").write_text(text, encoding="utf-8")
    source = scan_of(DECLARED, tmp_path).source
    assert source.photons_in(np.array([30.0, 31, 32, 33]))[0] == pytest.approx([5, 10, 5])
    assert scan_of(f"{DECLARED}, photons: 100", tmp_path).source.photons == pytest.approx(100)
    behind = scan_of(f"{DECLARED}, filters: [{{composition: Al, thickness: 2}}]", tmp_path).source
    assert 0 < behind.photons < 20


@pytest.mark.parametrize(
    ("values", "energies", "text", "edges", "photons"),
    [
        ("per_bin", "centres", "30 1\n32 4\n34 2", [29, 31, 33, 35], [1, 4, 2]),
        ("per_kev", "centres", "30 1\n32 4\n34 2", [29, 31, 33, 35], [2, 8, 4]),
        ("per_bin", "edges", "30 1\n32 4\n35 0", [30, 32, 35], [1, 4]),
        ("per_kev", "edges", "30 1\n32 4\n35 0", [30, 32, 35], [2, 12]),
    ],
)
def test_bins_are_what_the_scene_declares(tmp_path, values, energies, text, edges, photons):
    (tmp_path / "a.csv").write_text(text, encoding="utf-8")
    found = read_spectrum(tmp_path / "a.csv", values, energies)
    assert found[0] == pytest.approx(edges)
    assert found[1] == pytest.approx(photons)


def test_a_table_of_spekpy_is_spekpy(tmp_path):
    import spekpy

    energy, density = spekpy.Spek(kvp=100, th=12, dk=0.5).filter("Al", 3).get_spectrum(flu=True, diff=True)
    np.savetxt(tmp_path / "tube.csv", np.stack([energy, density], axis=1), delimiter=",")
    source = scan_of(f"{TABLE}, values: per_kev, energies: centres", tmp_path).source
    assert source.photons == pytest.approx(density.sum() * 0.5, rel=1e-12)
    assert source.photons_in(np.array([1.0, 100.0]))[1][0] == pytest.approx(density @ energy / density.sum(), rel=1e-12)


@pytest.mark.parametrize("missing", ["values", "energies"])
def test_what_a_table_holds_is_never_guessed(missing):
    declared = {"values": "per_bin", "energies": "edges"}
    del declared[missing]
    message = refusal(f"{TABLE}, " + ", ".join(f"{k}: {v}" for k, v in declared.items()))
    options = {"values": "per_bin, per_kev", "energies": "centres, edges, corners"}[missing]
    assert message == f"./toy.yaml:3:9: source.{missing} - is missing: choose from {options}"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("30 1\n29 1\n31 1", "a.csv:2: energies must ascend, but 29 keV follows 30 keV"),
        ("30 1\n30 1\n31 1", "a.csv:2: energies must ascend, but 30 keV follows 30 keV"),
        ("30 1\n\n31 -2", "a.csv:3: photons must not be negative, got -2"),
        ("30 1\n31 nan", "a.csv:2: a number must be finite, got '31 nan'"),
        ("30 1\ninf 2", "a.csv:2: a number must be finite"),
        ("30 1", "at least two rows of energy and photons, got 1"),
        ("", "at least two rows of energy and photons, got 0"),
        ("energy,photons\n30,1\n31,1", "a.csv:1: 'energy,photons' is not two numbers; a header starts with #"),
        ("30 1\n31 1 4", "a.csv:2: a row has two columns, energy .keV. and photons, got 3"),
        ("30\n31", "a.csv:1: a row has two columns, energy .keV. and photons, got 1"),
        ("30000 1\n31000 2", "a.csv:1: .* got 30000; are they in another unit?"),
        ("30 0\n31 0", "a.csv holds no photons"),
        ("30 1\n31 1\n33 1", "a.csv:2: centres must be evenly spaced, here by 1.5 keV, but 31 stands where 31.5 would"),
    ],
)
def test_wrong_tables_are_one_sentence_with_file_and_line(tmp_path, text, message):
    (tmp_path / "a.csv").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=message) as caught:
        read_spectrum(tmp_path / "a.csv", "per_bin", "centres")
    assert "\n" not in str(caught.value)


def test_the_last_edge_ends_the_table(tmp_path):
    (tmp_path / "a.csv").write_text("30 1\n31 2\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"a.csv:2: the last of the edges .* must be 0, got 2"):
        read_spectrum(tmp_path / "a.csv", "per_bin", "edges")


def test_a_missing_table_is_named_with_its_place_in_the_scene(tmp_path):
    message = refusal(DECLARED, tmp_path)
    assert message.startswith(f"{tmp_path}/toy.yaml:3:")
    assert "source.file - " in message
    assert "tube.csv cannot be read as a spectrum: No such file" in message


@pytest.mark.parametrize("source", ["tube", "table", "lines"])
def test_an_exported_spectrum_gives_the_same_counts(tmp_path, source):
    if source == "table":
        (tmp_path / "own.csv").write_text("20 1\n21 3\n23.5 2\n60 0\n")
    own = {
        "tube": "{type: tube, kvp: 140, filters: [{composition: Gd, thickness: 0.1}], photons: 1.0e+5}",
        "table": "{type: table, file: own.csv, values: per_bin, energies: edges, photons: 1.0e+5}",
        "lines": "{type: lines, lines: {30: 1, 66.1: 2}, photons: 1.0e+5}",
    }[source]
    (tmp_path / "toy.yaml").write_text(SCENE.format(source=own))
    result = CliRunner().invoke(main, ["spectrum", str(tmp_path / "toy.yaml"), "--export", str(tmp_path / "out.csv")])
    assert result.exit_code == 0, result.output
    again = "{type: table, file: out.csv, values: per_kev, energies: corners}"
    scans = [load_scene(SceneFile(str(tmp_path / "toy.yaml"), SCENE.format(source=s))) for s in (own, again)]
    lengths = np.array([[0.0], [50.0], [200.0]])
    counts = [fine_transmission(scan).expected(lengths) for scan in scans]
    assert counts[0].min() > 0.1
    np.testing.assert_allclose(counts[1], counts[0], rtol=1e-9)
    spectra = [reconstructor_spectra(scan) for scan in scans]
    np.testing.assert_array_equal(spectra[1].edges, spectra[0].edges)
    np.testing.assert_allclose(spectra[1].weights, spectra[0].weights, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    ("rows", "values", "message"),
    [
        ("20 1\n19 2\n", "per_kev", "b.csv:2: energies must ascend"),
        ("20 1\n30 2\n", "per_bin", "per_kev, got per_bin"),
        ("20 1\n30 2 peak\n", "per_kev", "a row has two columns"),
        ("20 1\n", "per_kev", "b.csv: a spectrum needs two corners"),
        ("# none\n", "per_kev", "at least one row"),
        ("20 0\n30 0\n", "per_kev", "b.csv: a spectrum needs photons"),
        ("0.5 1\n30 0\n", "per_kev", "within 1 .. 800 keV"),
    ],
)
def test_corners_that_make_no_spectrum_are_refused(tmp_path, rows, values, message):
    (tmp_path / "b.csv").write_text(rows)
    with pytest.raises(InputError, match=message):
        read_source(tmp_path / "b.csv", values, "corners")
