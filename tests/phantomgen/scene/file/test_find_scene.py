"""Names of scenes: files, presets, and files that are something else."""

import h5py
import pytest

from phantomgen.runtime.hdf5_signature import SIGNATURE, is_hdf5
from phantomgen.scene.file.find_scene import find_scene
from spectra.errors import SceneError


def test_a_preset_needs_no_option_and_a_file_of_its_name_wins(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    preset = find_scene("kedge-small", ["geometry.views=9"])
    assert (preset.name, preset.model.geometry.views) == ("kedge-small.yaml", 9)
    (tmp_path / "kedge-small").mkdir()
    assert find_scene("kedge-small").model.name == "kedge-small"
    (tmp_path / "kedge").write_text(preset.text.replace("name: kedge-small", "name: mine"))
    assert find_scene("kedge").model.name == "mine"


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("bracket.stl", b"\x80solid", "{type: mesh, file: bracket.stl, unit: mm, material: Al}"),
        ("ct.nii.gz", b"\x1f\x8b", "is a volume and no scene"),
        ("text.yaml", b"\xff\xfe", "it is not UTF-8 text"),
    ],
)
def test_files_of_other_kinds_are_told_by_what_they_are(name, content, said, tmp_path):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(SceneError) as error:
        find_scene(tmp_path / name)
    assert said in str(error.value)


@pytest.mark.parametrize(
    ("content", "expected"), [(SIGNATURE + b"rest", True), (SIGNATURE[:-1], False), (b"", False), (None, False)]
)
def test_hdf5_is_told_by_its_first_bytes(content, expected, tmp_path):
    if content is not None:
        (tmp_path / "any").write_bytes(content)
    assert is_hdf5(tmp_path / "any") is expected


def test_a_dataset_is_sent_to_the_commands_that_take_it(tmp_path):
    h5py.File(tmp_path / "scan.dat", "w").close()
    with pytest.raises(SceneError, match=r"`phantomgen view .*scan.dat` shows a dataset"):
        find_scene(tmp_path / "scan.dat")
