"""Voxel phantoms in the format of ICRP Publication 110, with a small body of our own in place of theirs."""

import numpy as np
import pytest
import yaml
from click.testing import CliRunner

import phantomgen
from phantomgen.cli.main import main
from phantomgen.importers.icrp import read_phantom, write_scene
from spectra.errors import InputError

SHAPE = (19, 9, 6)  # columns, rows, slices
VOXEL = (10.0, 8.0, 20.0)  # mm
ORGANS = """\
Organ ID  Organ/tissue                                Tissue  Density
                                                      number  [g/cm3]

1     Adrenal, left                                    1    1.030
13    Humeri, upper half, cortical                     2    1.904
100   Residual tissue, right arm                       3    0.950
101   Residual tissue, trunk                           3    0.950
122   Skin, head                                       4    1.089
125   Skin, trunk (of 2 parts)                         4    1.100
"""
MEDIA = """\
Media, elemental compositions
(percent by mass)        H    C    N    O    Na   Mg   P    S    Cl   K    Ca   Fe   I

1    Adrenals                              10.4 22.1  2.8 63.7  0.1  0.0  0.2  0.3  0.2  0.2  0.0  0.0  0.0
2    Mineral bone 1.9                       3.6 15.9  4.2 44.8  0.3  0.2  9.4  0.3  0.0  0.0 21.3  0.0  0.0
3    Residual tissue                       11.4 58.1  0.7 29.3  0.1  0.0  0.0  0.2  0.2  0.0  0.0  0.0  0.0
4    Skin                                  10.0 19.9  4.2 65.0  0.2  0.0  0.1  0.2  0.3  0.1  0.0  0.0  0.0
"""


def body():
    """Organs (slice, row, column): a trunk within skin, an arm on the patient's right, an adrenal on the left."""
    organs = np.zeros(SHAPE[::-1], np.int64)
    organs[:, 1:8, 5:18] = 125
    organs[:, 2:7, 6:17] = 101
    organs[:, 3:6, 1:3] = 100
    organs[2:, 4, 1] = 13
    organs[3, 5, 14] = 1
    organs[5] = np.where(organs[5] > 0, 122, 0)
    return organs


def write_body(folder, organs, name="AX", of_organs=ORGANS, media=MEDIA):
    """Write the files, sixteen numbers per line as the ICRP does."""
    folder.mkdir(exist_ok=True)
    flat = organs.ravel()
    lines = [" ".join(str(number) for number in flat[k : k + 16]) for k in range(0, len(flat), 16)]
    (folder / f"{name}.dat").write_text("\n".join(lines) + "\n")
    (folder / f"{name}_organs.dat").write_text(of_organs)
    (folder / f"{name}_media.dat").write_text(media)
    return folder


@pytest.fixture
def folder(tmp_path):
    return write_body(tmp_path / "AX", body())


def test_columns_run_to_the_left_and_rows_to_the_back(folder):
    phantom = read_phantom(folder, SHAPE, VOXEL)
    labels = phantom.labels
    z, y, x = np.argwhere(labels == 1)[0]
    assert (z, y, x) == (3, SHAPE[1] - 1 - 5, SHAPE[0] - 1 - 14)  # x grows to the patient's right, y to the front
    assert np.argwhere(labels == 100)[:, 2].min() > x
    assert phantom.organs[125].name == "Skin, trunk (of 2 parts)"
    name, parts = phantom.media[2]
    assert name == "Mineral bone 1.9"
    assert parts["Ca"] == pytest.approx(0.213)
    assert sum(parts.values()) == pytest.approx(1)


def test_the_scene_holds_each_organ_with_its_volume_and_its_density(folder, tmp_path):
    phantom = read_phantom(folder, SHAPE, VOXEL)
    scene, _ = write_scene(phantom, tmp_path / "body.yaml")
    few = {"geometry.views": 2, "geometry.test_views": 0, "panel": {"rows": 8, "columns": 8, "pitch": 60}}
    scan = phantomgen.load(scene, few)
    document = yaml.safe_load(scene.read_text())
    assert document["materials"]["skin_1.089"]["density"] == 1.089
    assert document["materials"]["residual_tissue"]["density"] == 0.95  # of two organs
    with phantomgen.make(scan, tmp_path / "body.h5", tolerance=1e-2, seed=1) as dataset:
        truth = phantomgen.read_truth(dataset.path)
        voxel = np.prod(truth.grid.spacing)
        for name, organs in (("residual_tissue", (100, 101)), ("mineral_bone_1_9", (13,)), ("adrenals", (1,))):
            found = truth.fractions[truth.material_names.index(name)].sum() / 65535 * voxel
            expected = np.isin(body(), organs).sum() * np.prod(VOXEL)
            assert found == pytest.approx(expected, rel=1e-3), name


def test_a_part_of_a_body_without_its_arms(folder, tmp_path):
    phantom = read_phantom(folder, SHAPE, VOXEL)
    scene, labels = write_scene(phantom, tmp_path / "part.yaml", heights=(35, 90), without=("arm", "Humeri"))
    stored = np.load(labels)["labels"]
    assert stored.shape == (2, 7, 13)  # slices at 50 and 70 mm; arms and air around the trunk are gone
    assert set(np.unique(stored)) == {1, 101, 125}
    assert "Humeri" not in scene.read_text()


def test_the_command(folder, tmp_path):
    words = [
        "import",
        "icrp",
        str(folder),
        "-o",
        str(tmp_path / "body.yaml"),
        "--shape",
        "19,9,6",
        "--voxel",
        "10,8,20",
    ]
    result = CliRunner().invoke(main, words)
    assert result.exit_code == 0, result.output
    assert "body-labels.npz" in result.output
    assert phantomgen.load(tmp_path / "body.yaml").name == "body"
    again = CliRunner().invoke(main, words)
    assert again.exit_code == 1
    assert "exists" in again.stderr


def spoiled(folder, **changed):
    write_body(folder, **{"organs": body(), **changed})
    return folder


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"organs": body()[:-1]}, r"AX\.dat has 855 numbers, where its voxels need 1026"),
        ({"organs": np.concatenate([body(), body()])}, r"AX\.dat has more than 1026 numbers"),
        ({"organs": body() + 256}, "organs have numbers from 0 to 255"),
        ({"organs": np.where(body() == 1, 7, body())}, r"has organ 7, which AX_organs\.dat does not name"),
        ({"of_organs": "nothing\n"}, r"AX_organs\.dat has no line with the number of an organ"),
        ({"media": MEDIA.replace("4    Skin ", "5    Skin ")}, r"gives organ 122 medium 4, which has no composition"),
        ({"media": MEDIA.replace("65.0", "35.0")}, r"the elements of Skin sum to 70 %"),
        ({"media": ""}, r"AX_media\.dat has no line with the number of a medium"),
    ],
)
def test_files_that_are_not_in_this_format_are_one_sentence(tmp_path, changed, words):
    with pytest.raises(InputError, match=words) as caught:
        read_phantom(spoiled(tmp_path / "AX", **changed), SHAPE, VOXEL)
    assert "\n" not in str(caught.value)


def test_what_is_missing_is_asked_for(folder, tmp_path):
    with pytest.raises(InputError, match="give --shape COLUMNS,ROWS,SLICES and --voxel X,Y,Z"):
        read_phantom(folder)
    with pytest.raises(InputError, match=r"must be a folder with NAME\.dat"):
        read_phantom(tmp_path, SHAPE, VOXEL)
    with pytest.raises(InputError, match="10000 x 10000 x 10000 voxels are too many"):
        read_phantom(folder, (10_000, 10_000, 10_000), VOXEL)
    phantom = read_phantom(folder, SHAPE, VOXEL)
    with pytest.raises(InputError, match="there is no slice from 500 to 600 mm"):
        write_scene(phantom, tmp_path / "none.yaml", heights=(500, 600))
    with pytest.raises(InputError, match="no voxel of AX is left"):
        write_scene(phantom, tmp_path / "none.yaml", without=("a", "e", "i"))
    assert not (tmp_path / "none.yaml").exists()


@pytest.mark.parametrize(
    "option", [("--shape", "19,9"), ("--shape", "19,9,6.5"), ("--voxel", "1,2,0"), ("--heights", "9:3")]
)
def test_options_that_cannot_be_are_wrong_usage(folder, tmp_path, option):
    result = CliRunner().invoke(main, ["import", "icrp", str(folder), "-o", str(tmp_path / "a.yaml"), *option])
    assert result.exit_code == 2
    assert option[0] in result.stderr
