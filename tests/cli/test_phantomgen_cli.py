"""The command line: what it prints, how it ends, and that it starts fast."""

import json
import subprocess
import sys

import pytest
from click.testing import CliRunner
from support.edited_datasets import edited_dataset

from phantomgen.cli.main import main
from phantomgen.dataset.reader import open_dataset

SCENE = """\
version: 1
name: toy
source: {type: monochromatic, energy: 60, photons: 1000}
detector: {type: photon_counting, thresholds: [20]}
geometry: {type: circular, sod: 100, sdd: 200, views: 3, test_views: 1}
panel: {rows: 12, columns: 16, pitch: 2}
volume: {voxels: 8, size: 20}
materials:
  water: {composition: H2O, density: 1.0}
objects:
  - {type: sphere, material: water, radius: 5}
flats: 2
"""


def run(*arguments: str):
    return CliRunner().invoke(main, [str(a) for a in arguments])


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("cli")
    (folder / "toy.yaml").write_text(SCENE)
    result = run("make", folder / "toy.yaml", "-o", folder / "toy.h5", "--json")
    assert result.exit_code == 0, result.output
    return folder, json.loads(result.stdout)


def test_make_writes_a_dataset_and_prints_one_object(made):
    folder, summary = made
    assert summary["path"] == str(folder / "toy.h5")
    assert summary["shape"] == [4, 1, 12, 16]
    assert summary["plan"]["nodes"] == [1]
    assert summary["seconds"]["total"] == pytest.approx(sum(v for k, v in summary["seconds"].items() if k != "total"))
    assert summary["error"]["edge_worst"] < 1e-3
    assert sorted(p.name for p in folder.iterdir() if p.suffix != ".yaml") == ["toy.h5"]


def test_make_says_what_it_took_how_wrong_it_is_and_what_to_do_next(made):
    folder, _ = made
    result = run(
        "make", folder / "toy.yaml", "-o", folder / "again.h5", "--views", "2", "--test-views", "0", "--seed", "4"
    )
    (folder / "again.h5").unlink()
    assert result.exit_code == 0
    assert "2 views x 1 channels x 12 x 16" in result.stdout
    assert "rms" in result.stdout
    assert f"recon fit {folder / 'again.h5'}" in result.stdout
    assert result.stderr == ""


def test_options_override_the_scene(made):
    folder, _ = made
    path = folder / "options.h5"
    options = [
        "--views",
        "5",
        "--test-views",
        "2",
        "--voxels",
        "4",
        "--no-noise",
        "--keep",
        "expected",
        "--set",
        "flats=1",
    ]
    assert run("make", folder / "toy.yaml", "-o", path, "-q", *options).exit_code == 0
    with open_dataset(path) as dataset:
        assert dataset.counts.shape[0] == 7
        assert dataset.grid.shape == (4, 4, 4)
        assert dataset.counts.dtype == "float32"
        assert (dataset.file["truth/expected"][()] == dataset.counts[()]).all()
    path.unlink()


def test_an_output_that_exists_is_refused_before_any_work(made):
    folder, _ = made
    result = run("make", folder / "toy.yaml", "-o", folder / "toy.h5")
    assert (result.exit_code, result.stdout) == (1, "")
    assert result.stderr == (
        f"Error: the output {folder / 'toy.h5'} exists: choose another name by --out, or add --overwrite\n"
    )


@pytest.mark.parametrize(
    ("arguments", "code", "expected"),
    [
        (["make"], 2, "name either a scene file or a preset"),
        (["make", "a.yaml", "--preset", "kedge"], 2, "name either a scene file or a preset"),
        (["make", "--preset", "kegde"], 1, "unknown preset 'kegde'; did you mean 'kedge'?"),
        (["make", "none.yaml"], 1, "there is no scene file none.yaml"),
        (["make", "kedge.yaml"], 1, "the preset is called kedge, without .yaml"),
        (["make", "kedge-smal"], 1, "did you mean kedge-small or"),
        (["plan", "kedge-smal"], 1, "`phantomgen presets` lists them"),
        (["make", "."], 1, ". is a folder: a scene is a YAML file"),
        (["make", "kedge-small", "-o", "x.nii"], 1, "write x.h5, from which `phantomgen export x.h5 -o x.nii`"),
        (["make", "kedge-small", "-o", "x"], 1, "whose name ends in .h5, .hdf5, .nxs: write x.h5"),
        (["info", "kedge"], 1, "there is no dataset kedge; `phantomgen make kedge` makes one"),
        (["make", "--preset", "kedge", "--views", "0"], 2, "0 is not in the range x>=1"),
        (
            ["make", "--preset", "kedge", "--set", "objects.0.radius=-1"],
            1,
            "objects.0.radius - input should be greater",
        ),
        (
            ["make", "--preset", "kedge", "--set", "source.kvp=70"],
            1,
            "channel bin3 starts at 80 keV and sees no photons",
        ),
        (["make", "--preset", "kedge", "-o", "none/kedge.h5"], 1, "folder none for the output kedge.h5 does not exist"),
        (["info", "none.h5"], 1, "there is no dataset none.h5"),
        (["validate", "none.h5"], 1, "there is no dataset none.h5"),
        (["presets", "show", "none"], 1, "unknown preset 'none'"),
        (["view"], 2, "name a scene file, a preset or a dataset"),
        (["view", "--preset", "kedge"], 1, "there is no display to open a window on: write a picture by --screenshot"),
        (["view", "kedge", "--html", "kedge.htm"], 1, "--html writes a .html file, got kedge.htm"),
        (["view", "kedge", "--html", "none/k.html"], 1, "folder none for the output k.html does not exist"),
        (
            ["view", "kegde", "--screenshot", "k.png"],
            1,
            "neither a scene file nor a preset 'kegde'; did you mean kedge",
        ),
        (["view", "none.h5", "--screenshot", "k.png"], 1, "there is no dataset none.h5"),
        (["view", "kedge", "--screenshot", "k.png", "--at", "0,0"], 1, "a point is written x,y,z in mm"),
        (["view", "kedge", "--screenshot", "k.png", "--at", "0,0,99"], 1, "z = 99 mm lies outside the volume"),
        (["view", "kedge", "--screenshot", "k.png", "--size", "big"], 1, "a size is written WIDTHxHEIGHT"),
        (["materials", "livr"], 1, "unknown material 'livr'; did you mean 'liver'?"),
        (["materials", "Gd2O3"], 1, "material 'Gd2O3' needs a density in g/cm^3"),
        (["materials", "liver", "--plot", "none/liver.png"], 1, "folder none for the picture liver.png does not exist"),
        (["materials", "liver", "--plot", "liver.bmp"], 1, "a picture ends in .png, .pdf or .svg, got 'liver.bmp'"),
        (["materials", "bone", "--scene", "kedge"], 1, "material 'bone' is given by coefficients"),
        (["materials", "bne", "--scene", "kedge"], 1, "kedge.yaml has no material 'bne'; did you mean 'bone'?"),
        (["make", "--preset", "kedge", "--compression", "zip"], 1, "there is no compression 'zip': choose from gzip"),
        (["batch", "none.yaml"], 1, "none.yaml cannot be read as a manifest: No such file or directory"),
        (
            ["batch", "none.yaml", "--shard", "3/2"],
            1,
            "--shard is written i/n with 1 <= i <= n, such as 1/4, got '3/2'",
        ),
        (["frobnicate"], 2, "No such command"),
    ],
)
def test_bad_input_is_one_sentence_and_leaves_nothing(arguments, code, expected, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    result = run(*arguments)
    assert (result.exit_code, result.stdout) == (code, "")
    assert expected in result.stderr
    if code == 1:
        assert result.stderr.startswith("Error: ")
        assert result.stderr.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_an_object_outside_the_panel_is_a_warning_that_says_how_much(made):
    folder, _ = made
    path = folder / "outside.h5"
    result = run("make", folder / "toy.yaml", "-o", path, "--set", "objects.0.center=[0, 0, 9]")
    path.unlink()
    assert result.exit_code == 0
    assert "Warning: object 0 (water) leaves the panel's field of view in 100% of the views" in result.stderr
    assert "mm on the panel" in result.stderr
    assert "reaches 4 mm beyond the volume" in result.stderr


def test_debug_shows_the_traceback():
    result = run("make", "--preset", "none", "--debug")
    assert result.exit_code == 1
    assert type(result.exception).__name__ == "SceneError"


def test_info_describes_a_dataset(made):
    folder, _ = made
    text = run("info", folder / "toy.h5").stdout
    for words in (
        "toy",
        "4 views x 1 channels x 12 x 16",
        "3 train, 1 test",
        "2 flats, 1 darks",
        "photoelectric, compton",
    ):
        assert words in text
    described = json.loads(run("info", folder / "toy.h5", "--json").stdout)
    assert described["sdd_mm"] == pytest.approx(200.0)
    assert described["truth"] == ["basis", "fractions", "grid", "labels", "materials", "plan", "scene"]


def test_validate_ends_with_0_or_3(made, tmp_path):

    folder, _ = made
    assert run("validate", folder / "toy.h5").stdout == f"{folder / 'toy.h5'} is valid\n"
    bad = tmp_path / "bad.h5"
    bad.write_bytes((folder / "toy.h5").read_bytes())
    with edited_dataset(bad) as file:
        file["entry/spectra/response"][0, 0] = -1.0
    result = run("validate", bad, "--json")
    assert result.exit_code == 3
    assert json.loads(result.stdout)["valid"] is False


@pytest.mark.usefixtures("renders")
def test_a_look_at_a_dataset_is_a_picture_and_a_page(made, tmp_path):
    folder, _ = made
    outputs = tmp_path / "toy.png", tmp_path / "toy.html"
    result = run("view", folder / "toy.h5", "--screenshot", outputs[0], "--html", outputs[1], "--size", "400x300")
    assert (result.exit_code, result.stderr) == (0, "")
    assert result.stdout.splitlines() == list(map(str, outputs))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["toy.html", "toy.png"]
    again = run("view", folder / "toy.h5", "--screenshot", outputs[0])
    assert again.exit_code == 1
    assert (
        again.stderr
        == f"Error: the output {outputs[0]} exists: choose another name by --screenshot, or add --overwrite\n"
    )
    before = outputs[0].read_bytes()
    assert run("view", folder / "toy.h5", "--screenshot", outputs[0], "--at", "1,1,1", "--overwrite").exit_code == 0
    assert outputs[0].read_bytes() != before
    refused = run("view", folder / "toy.h5", "--html", tmp_path / "other.html", "--voxels", "4")
    assert "the truth in" in refused.stderr


@pytest.mark.usefixtures("renders")
def test_a_look_at_a_dataset_without_truth_says_so(made, tmp_path):

    folder, _ = made
    bare = tmp_path / "bare.h5"
    bare.write_bytes((folder / "toy.h5").read_bytes())
    with edited_dataset(bare) as file:
        del file["truth"]
    result = run("view", bare, "--screenshot", tmp_path / "bare.png", "--size", "400x300")
    assert (result.exit_code, result.stderr) == (0, f"Note: {bare} holds no truth, so only the scan is shown.\n")


def test_presets_are_listed_and_shown_as_scenes_that_can_be_made(tmp_path):
    names = [line.split()[0] for line in run("presets").stdout.splitlines()]
    from phantomgen.scene.file.scene_file import SceneFile, preset_names

    assert names == preset_names()
    assert {"contrast-vials", "kedge", "kedge-small", "multi-energy"} <= set(names)

    (tmp_path / "my.yaml").write_text(run("presets", "show", "kedge").stdout)
    assert SceneFile.read(tmp_path / "my.yaml").model == SceneFile.preset("kedge").model


def test_materials_are_listed_in_groups():
    groups = json.loads(run("materials", "--json").stdout)
    assert list(groups) == ["tissues", "plastics, minerals and others", "detectors", "elements", "NIST compounds"]
    assert groups["tissues"]["liver"] == 1.06
    assert groups["elements"]["Gd"] == pytest.approx(7.9, abs=0.01)
    assert groups["NIST compounds"]["Water, Liquid"] == 1.0
    assert len(groups["NIST compounds"]) >= 180
    text = run("materials").stdout
    assert text.startswith("tissues [g/cm^3]\n  0.95       adipose\n")
    assert "  7.9004     Gd  gadolinium\n" in text


def test_a_material_is_described_with_its_fit(tmp_path):
    text = run("materials", "liver").stdout
    for words in ("liver: 1.06 g/cm^3, ICRU Report 44", "C 0.139", "photoelectric", "rms 0.1"):
        assert words in text
    water = json.loads(run("materials", "water", "--json").stdout)
    # NIST SRD 126 at 60 keV, and the fit of water's mass attenuation over 20 to 140 keV.
    assert water["mu_rho_cm2_per_g"][water["energy_keV"].index(60)] == pytest.approx(0.2059, rel=1e-3)
    assert water["coefficients_per_mm"] == pytest.approx({"photoelectric": 0.00138, "compton": 0.01788}, rel=5e-3)
    assert 1e-3 < water["fit_rms"] < 2.5e-3 < water["fit_worst"] < 2e-2
    vial = json.loads(run("materials", "gold_10", "--scene", "contrast-vials", "--json").stdout)
    assert vial["k_edges_keV"] == pytest.approx({"Au": 80.725}, abs=1e-3)
    assert vial["density"] == pytest.approx(1.01 - 0.01 / 19.32, rel=1e-6)
    oxide = run("materials", "Gd2O3", "--density", "7.4", "--plot", tmp_path / "oxide.png")
    assert oxide.exit_code == 0
    assert (tmp_path / "oxide.png").read_bytes().startswith(b"\x89PNG")


def test_schema_prints_the_layout_or_the_json_schema():
    assert "/entry/instrument/detector/data" in run("schema").stdout
    assert json.loads(run("schema", "--scene").stdout)["title"] == "SceneModel"


@pytest.mark.parametrize(
    "command",
    [
        [],
        ["make"],
        ["materials"],
        ["presets"],
        ["presets", "show"],
        ["view"],
        ["info"],
        ["validate"],
        ["schema"],
        ["batch"],
    ],
)
def test_every_help_ends_with_examples(command):
    result = run(*command, "--help")
    assert result.exit_code == 0
    assert result.stdout.rstrip().splitlines()[-3].strip() == "Examples:"


def test_help_imports_nothing_heavy():
    code = (
        "import sys; from phantomgen.cli.main import main; main(['--help'], standalone_mode=False);"
        "heavy = {'torch', 'h5py', 'numba', 'scipy', 'numpy', 'pydantic', 'pyvista', 'vtkmodules'};"
        "print(sorted(heavy & set(sys.modules)), file=sys.stderr)"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stderr.strip() == "[]"


def test_make_imports_neither_torch_nor_the_viewer():
    code = (
        "import sys, phantomgen.simulation.run, phantomgen.scene.scan, spectra.source.tube;"
        "sys.exit(bool({'torch', 'pyvista', 'vtkmodules'} & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_a_drawn_scene_is_shown_as_it_is_made(tmp_path):
    shown = run("presets", "show", "random", "--seed", 7, "--resolved")
    assert "uniform" not in shown.stdout
    assert shown.stdout == run("presets", "show", "random", "--set", "seed=7", "--resolved").stdout
    (tmp_path / "drawn.yaml").write_text(shown.stdout)
    assert run("presets", "show", tmp_path / "drawn.yaml", "--resolved").stdout == shown.stdout
    result = run("presets", "show", "random", "--seed", 7)
    assert result.exit_code == 2
    assert "--seed and --set need --resolved" in result.stderr


def test_plan_says_what_make_would_do(made):
    folder, _ = made
    text = run("plan", folder / "toy.yaml", "--tol", "1e-2").stdout
    for words in ("4 views (circular) x 1 channels", "effects none", "pixels  ", "meets 1e-02", "time    about", "MB"):
        assert words in text
    report = json.loads(run("plan", folder / "toy.yaml", "--json").stdout)
    assert report["plan"]["error"] <= report["plan"]["tolerance"] == 1e-3
    assert report["error"]["edge_worst"] < 1e-3
    assert report["cost"]["file_bytes"] > 0


@pytest.mark.parametrize(("tolerance", "code", "words"), [("1e-9", 3, "MISSES 1e-09"), ("5", 1, "--tol must lie in")])
def test_plan_ends_with_what_cannot_be_met(made, tolerance, code, words):
    folder, _ = made
    result = run("plan", folder / "toy.yaml", "--tol", tolerance)
    assert result.exit_code == code
    assert words in result.output
