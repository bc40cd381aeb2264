"""Find the scene file or preset of a name, and refuse files that are no scenes."""

from collections.abc import Sequence
from difflib import get_close_matches
from pathlib import Path

from phantomgen.runtime.hdf5_signature import is_hdf5
from phantomgen.scene.file.scene_file import SceneFile, preset_names
from spectra.errors import SceneError

SUFFIXES = (".yaml", ".yml", ".json")
_MESHES = (".stl", ".obj", ".ply", ".glb", ".3mf", ".step", ".stp")
_VOXELS = (".npy", ".nii", ".nii.gz", ".mha", ".mhd", ".nrrd", ".tif", ".tiff", ".dcm")


def find_scene(name: str | Path, overrides: Sequence[str] = ()) -> SceneFile:
    """Return the scene file of a name, else the preset.

    Parameters
    ----------
    name : path of a scene file, or name of a preset
    overrides : ``path=value`` with dotted paths

    Returns
    -------
    the scene file

    Raises
    ------
    SceneError
        When there is neither, or the file is a dataset, a mesh or a volume.
    """
    path = Path(name)
    if path.is_file():
        refuse_other_files(path)
        return SceneFile.read(path, overrides)
    presets = preset_names()
    if str(name) in presets:
        return SceneFile.preset(str(name), overrides)
    if path.is_dir():
        raise SceneError(f"{path} is a folder: a scene is a YAML file in it, or a preset")
    if path.parent == Path() and path.suffix.lower() in SUFFIXES and path.stem in presets:
        raise SceneError(f"there is no scene file {path}; the preset is called {path.stem}, without {path.suffix}")
    if path.suffix.lower() in SUFFIXES or path.parent != Path():
        raise SceneError(f"there is no scene file {path}")
    near = get_close_matches(str(name), presets, 3)
    hint = f"; did you mean {' or '.join(near)}?" if near else ";"
    raise SceneError(f"there is neither a scene file nor a preset {str(name)!r}{hint} `phantomgen presets` lists them")


def refuse_other_files(path: Path) -> None:
    """Refuse a file that is no scene, by its name or its first bytes.

    Parameters
    ----------
    path : the file

    Raises
    ------
    SceneError
        When it is a dataset, a mesh or a volume.
    """
    name = path.name.lower()
    if is_hdf5(path):
        raise SceneError(
            f"{path} is HDF5 and no scene: `phantomgen view {path}` shows a dataset, `recon fit {path}` fits one"
        )
    for suffixes, kind, keys in (
        (_MESHES, "mesh", "unit: mm, material: Al"),
        (_VOXELS, "voxels", "labels: {1: water}, spacing: [1, 1, 1]"),
    ):
        if name.endswith(suffixes):
            what = "a mesh" if kind == "mesh" else "a volume"
            raise SceneError(
                f"{path} is {what} and no scene: write a scene that has it as an object, "
                f"{{type: {kind}, file: {path.name}, {keys}}}; "
                "`phantomgen presets show kedge > my.yaml` gives one to start from, "
                "docs/reference/scenes.md describes it"
            )
