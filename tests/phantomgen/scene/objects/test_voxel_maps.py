"""Voxel maps in scene files: formats, where a file lies in space, what values mean, and one sentence per mistake."""

import runpy
import shutil
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

from phantomgen.dataset.truth import read_truth
from phantomgen.exporters.nifti import write_nifti
from phantomgen.exporters.volumes import Volumes
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.scene.file.scene_file import SceneFile
from phantomgen.scene.objects.label_tables import NAMES, TISSUES
from phantomgen.scene.scan import load_scene
from phantomgen.simulation.checks.field_of_view import coverage_warnings
from phantomgen.simulation.forward_model.truth import scan_truth
from phantomgen.simulation.run import simulate
from phantomgen.volume_files.read import read_volume
from spectra.errors import InputError, NotInstalledError, SceneError
from spectra.materials.material import Material

HEAD = """\
version: 1
name: voxels
source: {type: monochromatic, energy: 60, photons: 1000}
detector: {type: photon_counting, thresholds: [20]}
geometry: {type: circular, sod: 500, sdd: 800, views: 2}
panel: {rows: 48, columns: 48, pitch: 1}
volume: {voxels: 8, size: 16}
materials:
  bone: {composition: cortical bone}
  soft_tissue: {composition: soft tissue}
  lung: {composition: lung, density: 0.26}
  adipose: {composition: adipose}
"""
EXAMPLES = Path(__file__).parents[4] / "examples"
LABELS = np.random.default_rng(0).integers(0, 3, (4, 5, 6)).astype(np.uint8)
SPACING = (1.0, 1.5, 2.0)  # x, y, z


def scan_of(folder: Path, text: str):
    return load_scene(SceneFile(str(folder / "scene.yaml"), f"{HEAD}objects:\n  - {{type: voxels, {text}}}\n"))


def written(folder: Path, kind: str, values: np.ndarray = LABELS) -> str:
    """Name of a file with some values, 1 mm along x, 1.5 along y, 2 along z; the first voxel lies at (3, 4, 5)."""
    if kind == "npy":
        np.save(folder / "map.npy", values)
        return "map.npy"
    if kind == "h5":
        with h5py.File(folder / "map.h5", "w") as file:
            file["some/labels"] = values
            file["some/grid/spacing"], file["some/grid/origin"] = SPACING[::-1], (5.0, 4.0, 3.0)
        return "map.h5:/some/labels"
    itk = pytest.importorskip("SimpleITK")
    image = itk.GetImageFromArray(values)
    image.SetSpacing(SPACING)
    image.SetDirection((-1, 0, 0, 0, -1, 0, 0, 0, 1))  # ITK counts to the left and to the back
    image.SetOrigin((-3, -4, 5))
    itk.WriteImage(image, str(folder / f"map.{kind}"))
    return f"map.{kind}"


FORMATS = ["npy", "h5", "nii", "nii.gz", "mha", "mhd", "nrrd"]


@pytest.mark.parametrize("kind", FORMATS)
def test_every_format_is_the_same_map(tmp_path: Path, kind: str) -> None:
    spacing = ", spacing: [1, 1.5, 2], center: [5.5, 7, 8]" if kind == "npy" else ""
    name = written(tmp_path, kind)
    scan = scan_of(tmp_path, f"file: '{name}', labels: {{1: bone, 2: soft_tissue}}{spacing}")
    ((shape, materials),) = scan.scene.objects
    assert [scan.scene.materials[i].name for i in materials] == ["bone", "soft_tissue"]
    np.testing.assert_allclose(shape.bounds, [[2.5, 3.25, 4], [8.5, 10.75, 12]], atol=1e-5)
    z, y, x = np.indices(LABELS.shape).reshape(3, -1)
    points = np.stack([3 + x, 4 + 1.5 * y, 5 + 2 * z], axis=1)
    np.testing.assert_array_equal(shape.contains(points), LABELS.ravel() > 0)


def test_directions_of_a_file_are_kept(tmp_path: Path) -> None:
    itk = pytest.importorskip("SimpleITK")
    image = itk.GetImageFromArray(LABELS)
    image.SetSpacing(SPACING)
    image.SetDirection((0, -1, 0, 1, 0, 0, 0, 0, 1))
    image.SetOrigin((3, 4, 5))
    itk.WriteImage(image, str(tmp_path / "turned.nii.gz"))
    ((shape, _),) = scan_of(tmp_path, "file: turned.nii.gz, labels: {1: bone, 2: soft_tissue}").scene.objects
    points = [image.TransformIndexToPhysicalPoint((x, y, z)) for z, y, x in np.ndindex(LABELS.shape)]
    np.testing.assert_array_equal(shape.contains(np.array(points) * (-1, -1, 1)), LABELS.ravel() > 0)


def test_what_is_exported_comes_back_where_it_was(tmp_path: Path) -> None:
    for package in ("SimpleITK", "nibabel"):
        pytest.importorskip(package)
    grid = Grid(LABELS.shape, SPACING[::-1], (5.0, 4.0, 3.0))
    write_nifti(tmp_path / "map.nii.gz", Volumes(grid, {"labels": LABELS}, "labels"))
    volume = read_volume("map.nii.gz", tmp_path)
    np.testing.assert_array_equal(volume.values, LABELS)
    np.testing.assert_allclose(volume.directions, np.eye(3), atol=1e-6)
    np.testing.assert_allclose(volume.origin, (3, 4, 5), atol=1e-5)
    np.testing.assert_allclose(volume.spacing, SPACING, atol=1e-6)


def test_a_folder_with_a_dicom_series(tmp_path: Path) -> None:
    itk = pytest.importorskip("SimpleITK")
    values = np.random.default_rng(1).integers(-900, 1500, (3, 4, 5)).astype(np.int16)
    writer = itk.ImageFileWriter()
    writer.KeepOriginalImageUIDOn()
    for z in range(3):
        image = itk.GetImageFromArray(values[z : z + 1])
        image.SetSpacing((1.0, 1.5, 2.0))
        image.SetOrigin((0, 0, 2.0 * z))
        for key, value in {
            "0008|0060": "CT",
            "0020|000d": "1.2.3",
            "0020|000e": "1.2.3.4",
            "0008|0018": f"1.2.3.4.{z + 1}",
            "0020|0032": f"0\\0\\{2 * z}",
            "0020|0037": "1\\0\\0\\0\\1\\0",
            "0020|0013": str(z),
            "0018|0050": "2",
        }.items():
            image.SetMetaData(key, value)
        writer.SetFileName(str(tmp_path / f"{5 - z}.dcm"))
        writer.Execute(image)
    volume = read_volume(".", tmp_path)
    np.testing.assert_array_equal(volume.values, values)
    np.testing.assert_allclose(volume.spacing, (1, 1.5, 2))
    scan = scan_of(tmp_path, "file: ., hu: default")
    assert {m.name for m in scan.scene.materials} == {"bone", "soft_tissue", "lung", "adipose"}


def test_intervals_of_hounsfield_units(tmp_path: Path) -> None:
    np.save(tmp_path / "hu.npy", np.array([-1000, -100, -100.5, 99.9, 100, 3000]).reshape(1, 1, 6))
    intervals = "hu: {soft_tissue: [-100, 100], bone: [100, 4000], lung: [-500, -100]}"
    ((shape, materials),) = scan_of(tmp_path, f"file: hu.npy, spacing: 1, {intervals}").scene.objects
    found = shape.content.mixtures[shape.content.cells.ravel()] @ (np.array(materials) + 1)
    names = [m.name for m in scan_of(tmp_path, f"file: hu.npy, spacing: 1, {intervals}").scene.materials]
    wanted = ["soft_tissue", "lung", "soft_tissue", "bone", "bone"]
    assert [names[int(i) - 1] for i in found[1:]] == wanted
    assert found[0] == 0


@pytest.mark.parametrize("way", ["apart", "together"])
@pytest.mark.slow
def test_fractions(tmp_path: Path, way: str) -> None:
    values = np.random.default_rng(2).dirichlet((1, 1, 1), (8, 8, 8)).astype(np.float32)
    parts = np.moveaxis(values, -1, 0)[:2]
    if way == "apart":
        for name, part in zip(("bone", "soft"), parts, strict=True):
            np.save(tmp_path / f"{name}.npy", part)
        text = "fractions: {bone: bone.npy, soft_tissue: soft.npy}"
    else:
        np.save(tmp_path / "both.npy", parts)
        text = "file: both.npy, fractions: [bone, soft_tissue]"
    scan = scan_of(tmp_path, f"{text}, spacing: 2")
    simulate(scan, tmp_path / "scan.h5")
    truth = read_truth(tmp_path / "scan.h5")
    np.testing.assert_allclose(truth.fractions / 65535, parts, atol=1e-5)


def test_a_scan_with_voxels_among_solids(tmp_path: Path) -> None:
    np.save(tmp_path / "map.npy", LABELS)
    solids = "  - {type: sphere, material: adipose, radius: 1.5, center: [1, 0, 0]}\n"
    text = f"file: map.npy, spacing: 2, rotation: [0, 0, 30], labels: {{1: bone, 2: null}}}}\n{solids}"
    text = f"{HEAD}objects:\n  - {{type: voxels, {text}"
    scan = load_scene(SceneFile(str(tmp_path / "scene.yaml"), text))
    summary = simulate(scan, tmp_path / "scan.h5", keep_expected=True)
    assert summary.error.edge_worst < 5e-3
    assert summary.error.edge_pixels > 10
    again = load_scene(SceneFile(str(tmp_path / "scene.yaml"), scan.text))
    assert again.text == scan.text
    copy = scan_of(tmp_path, "file: 'scan.h5:/truth/labels', labels: {1: bone, 2: soft_tissue, 3: lung}")
    np.testing.assert_allclose(copy.scene.objects[0][0].axes, 8 * np.eye(3))


def test_the_example_reads_what_its_script_writes(tmp_path: Path) -> None:
    for name in ("voxels.yaml", "make_voxels.py"):
        shutil.copy(EXAMPLES / name, tmp_path)
    runpy.run_path(str(tmp_path / "make_voxels.py"), run_name="__main__")
    scan = load_scene(tmp_path / "voxels.yaml", ["volume.voxels=32"])
    assert [m.name for m in scan.scene.materials] == ["tissue", "bone", "marrow", "iodine"]
    assert coverage_warnings(scan) == []
    truth = scan_truth(scan)
    filled = truth.fractions.sum(axis=(1, 2, 3)) / 65535 * truth.grid.voxel_volume
    labels = np.load(tmp_path / "voxels.npy")
    np.testing.assert_allclose(filled[1:3], [(labels == i).sum() / 8 for i in (2, 3)], rtol=0.01)
    assert truth.fractions.sum(axis=0).max() <= 65536


def test_warnings_are_about_what_is_not_empty(tmp_path: Path) -> None:
    labels = np.zeros((40, 40, 40), np.uint8)
    labels[19, 20:22, 20] = 1
    np.save(tmp_path / "map.npy", labels)
    assert coverage_warnings(scan_of(tmp_path, "file: map.npy, spacing: 2, labels: {1: bone}")) == []
    (warning, *_) = coverage_warnings(
        scan_of(tmp_path, "file: map.npy, spacing: 2, labels: {1: bone}, center: [9, 0, 0]")
    )
    assert "object 0 (bone) reaches 3 mm beyond the volume" in warning


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("file: map.npy, labels: {1: bone, 2: bone}", "spacing is missing"),
        ("file: map.npy, spacing: 1, labels: {1: bone}", "label 2 of 44 voxels in map.npy is missing"),
        (
            "file: map.npy, spacing: 1, labels: {1: bone, 2: boen}",
            "objects.0.labels.2 - unknown material 'boen'; did you",
        ),
        ("file: none.npy, spacing: 1, labels: {1: bone}", "there is no such file"),
        ("file: map.txt, spacing: 1, labels: {1: bone}", "a volume must be one of .npy, .nii"),
        ("file: map.h5, spacing: 1, labels: {1: bone}", "Write map.h5:/path"),
        ("file: 'map.h5:/other', labels: {1: bone}", "there is no dataset /other"),
        ("file: text.npy, spacing: 1, labels: {1: bone}", "cannot be read as an array"),
        ("file: text.nii, spacing: 1, labels: {1: bone}", "cannot be read as an image"),
        ("file: flat.npy, spacing: 1, labels: {1: bone}", "must be (z, y, x) or (part, z, y, x), got shape (4, 5)"),
        ("file: four.npy, spacing: 1, labels: {1: bone}", "four.npy must be (z, y, x), got shape (2, 4, 5, 6)"),
        ("file: half.npy, spacing: 1, labels: {1: bone}", "labels must be whole numbers, 120 are not"),
        ("file: nan.npy, spacing: 1, hu: default", "values must be finite, 1 are not"),
        ("file: map.npy, spacing: 1, labels: {1: null, 2: null}", "no voxel has a material"),
        ("file: map.npy, spacing: 1", "need one of labels, fractions and hu, got none"),
        ("file: map.npy, spacing: 1, labels: {}, hu: default", "got labels and hu"),
        ("spacing: 1, labels: {1: bone}", "objects.0.file - stands for labels"),
        ("file: four.npy, spacing: 1, fractions: [bone]", "must be (1, z, y, x) for 1 materials"),
        ("file: four.npy, spacing: 1, fractions: [bone, lung]", "more than 1, they do in 120 voxels, up to 1.5"),
        ("spacing: 1, fractions: {bone: less.npy}", "must not be negative, those of bone are down to -0.5"),
        ("spacing: 1, fractions: {bone: half.npy, lung: small.npy}", "small.npy must be (z, y, x) like the others"),
        ("file: hu.npy, spacing: 1, hu: {bone: [0, 100]}", "lie in no interval"),
        ("file: hu.npy, spacing: 1, hu: {bone: [0, 100], lung: [50, 4000]}", "not overlap another"),
        ("material: bone, file: map.npy, spacing: 1, labels: {1: bone}", "objects.0.material - belongs"),
    ],
)
def test_mistakes_are_one_sentence(tmp_path: Path, text: str, words: str) -> None:
    written(tmp_path, "npy")
    written(tmp_path, "h5")
    for name, values in {
        "flat": np.ones((4, 5)),
        "four": np.full((2, 4, 5, 6), 0.75),
        "half": np.full((4, 5, 6), 0.5),
        "less": np.full((4, 5, 6), -0.5),
        "small": np.full((2, 5, 6), 0.5),
        "hu": np.full((1, 2, 3), 1000.0),
        "nan": np.where(np.arange(120) == 7, np.nan, 0).reshape(4, 5, 6),
    }.items():
        np.save(tmp_path / f"{name}.npy", values)
    for name in ("text.npy", "text.nii", "map.txt"):
        (tmp_path / name).write_text("no numbers")
    with pytest.raises(SceneError) as caught:
        scan_of(tmp_path, text)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_voxels_are_no_part_of_a_shape() -> None:
    text = "{type: union, material: bone, shapes: [{type: voxels, file: map.npy, labels: {1: bone}}]}"
    with pytest.raises(SceneError, match="cannot be combined with shapes"):
        load_scene(SceneFile("scene.yaml", f"{HEAD}objects: [{text}]"))


def test_without_the_reader_the_sentence_names_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "map.nii").write_bytes(b"")
    monkeypatch.setitem(sys.modules, "SimpleITK", None)
    with pytest.raises(NotInstalledError, match=r"pip install 'spectral-ct\[images\]'"):
        read_volume("map.nii", tmp_path)
    monkeypatch.undo()
    with pytest.raises(InputError, match="one DICOM series"):
        read_volume(".", tmp_path)


def of_a_program(folder, labels, more=""):
    np.save(folder / "map.npy", labels)
    return scan_of(folder, f"file: map.npy, labels: totalsegmentator, spacing: 1{more}")


def test_labels_of_a_program_are_tissues(tmp_path):
    labels = np.array([0, 1, 5, 10, 52, 91, 117, 0], np.uint8).reshape(2, 2, 2)
    scan = of_a_program(tmp_path, labels)
    ((_, parts),) = scan.scene.objects
    assert [scan.scene.materials[i].name for i in parts] == ["spleen", "liver", "lung", "blood", "cranium", "cartilage"]
    changed = of_a_program(tmp_path, labels, ", relabel: {52: bone, 1: null}")
    ((_, parts),) = changed.scene.objects
    assert [changed.scene.materials[i].name for i in parts] == ["liver", "lung", "bone", "cranium", "cartilage"]


def test_all_labels_of_a_program_have_a_known_tissue(tmp_path):
    for program, table in TISSUES.items():
        assert list(table) == list(range(1, len(table) + 1)) == list(NAMES[program])
        assert len(set(NAMES[program].values())) == len(table)
        for name in table.values():
            assert Material(name, composition=name).density > 0
    assert {NAMES["totalsegmentator"][n] for n in (26, 50, 92, 115)} == {
        "vertebrae_S1",
        "vertebrae_C1",
        "rib_left_1",
        "rib_right_12",
    }


@pytest.mark.parametrize(
    ("labels", "more", "sentence"),
    [
        ([1, 118], "", "label 118 of 1 voxels in map.npy is missing"),
        ([1, 2], ", relabel: {2: unobtainium}", "unobtainium"),
    ],
)
def test_labels_that_a_program_does_not_know_are_refused(labels, more, sentence, tmp_path):
    with pytest.raises(SceneError, match=sentence):
        of_a_program(tmp_path, np.array(labels, np.uint8).reshape(1, 1, 2), more)


def test_lungs_need_a_density_and_changes_a_table(tmp_path, monkeypatch):
    monkeypatch.setattr(sys.modules[__name__], "HEAD", HEAD.replace("  lung: {composition: lung, density: 0.26}\n", ""))
    with pytest.raises(SceneError, match="lungs hold air, the known material does not: add 'lung:"):
        of_a_program(tmp_path, np.array([1, 10], np.uint8).reshape(1, 1, 2))
    with pytest.raises(SceneError, match="relabel - changes labels of a program, and needs labels: totalsegmentator"):
        scan_of(tmp_path, "file: map.npy, labels: {1: bone, 10: bone}, relabel: {1: bone}, spacing: 1")
