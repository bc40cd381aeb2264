"""A scene built in Python: the mapping of a scene file, checked by the same models and told by the same sentences."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Real

from phantomgen.building.defaults import completed
from phantomgen.building.shapes import Described
from phantomgen.dataset.truth import Truth
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.runtime.outputs import check_output
from phantomgen.scene.file.find_scene import find_scene
from phantomgen.scene.file.scene_file import Overrides, SceneFile, plain, scene_text
from phantomgen.scene.scan import Scan, load_scene
from phantomgen.scene.schema import SceneModel
from phantomgen.simulation.forward_model.energy_grids import material_coefficients
from phantomgen.simulation.forward_model.truth import scan_truth
from spectra.errors import InputError
from spectra.materials.material import Material

Section = Mapping[str, Any]


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Scene:
    """What is scanned and how, with the keys of a scene file; every key but the objects has a default.

    Sections are mappings with the keys of scene files, such as ``geometry={"views": 30}``. Keys that a section leaves
    out have the defaults of `phantomgen.building.defaults`: a tube at 120 kV, five channels, a circular orbit, and a
    panel and a volume that fit the objects. A section of another ``type`` must be complete.

    Parameters
    ----------
    objects : shapes such as `phantomgen.Cylinder`, or mappings as in scene files; later ones override earlier ones
    name : of the scan
    materials : by name, as mappings or `spectra.Material`; materials known by name, such as water, need none
    source, detector, geometry, panel, volume, effects, time : sections of a scene file
    basis : basis functions; those that the materials need where left out
    overlap, background, tessellation : see `phantomgen.scene.schema.SceneModel`
    seed, noise : key of the noise, and whether there is any
    flats, darks : number of frames of the open beam, and without beam
    folder : where relative paths of files in the scene start

    Raises
    ------
    SceneError
        With the key of what is wrong.
    """

    objects: Sequence[Described | Section]
    name: str = "scene"
    materials: Mapping[str, Section | Material] = field(default_factory=dict)
    source: Section | None = None
    detector: Section | None = None
    geometry: Section | None = None
    panel: Section | None = None
    volume: Section | None = None
    effects: Section | None = None
    time: Section | None = None
    basis: Sequence[Section] | None = None
    overlap: str | None = None
    background: str | None = None
    tessellation: int | str | None = None
    seed: int | None = None
    noise: bool | None = None
    flats: int | None = None
    darks: int | None = None
    folder: Path | str = Path()

    def __post_init__(self) -> None:
        _ = self.file.model

    @classmethod
    def read(cls, scene: Path | str, overrides: Overrides = ()) -> "Scene":
        """Read a scene file or a preset.

        Parameters
        ----------
        scene : path of a scene file, or name of a preset
        overrides : values by dotted path, or texts ``path=value``

        Returns
        -------
        the scene
        """
        path = Path(scene)
        return cls._of(find_scene(scene).changed(overrides), path.parent if path.is_file() else Path())

    @classmethod
    def from_yaml(cls, text: str, folder: Path | str = Path()) -> "Scene":
        """Read a scene from YAML.

        Parameters
        ----------
        text : text of a scene file
        folder : where relative paths of files in the scene start

        Returns
        -------
        the scene
        """
        return cls._of(SceneFile(str(Path(folder, "scene.yaml")), text), folder)

    @classmethod
    def _of(cls, file: SceneFile, folder: Path | str) -> "Scene":
        """The scene of a file, checked there, so that errors name its lines."""
        _ = file.model
        return cls(**{key: value for key, value in file.template.items() if key != "version"}, folder=folder)

    @cached_property
    def file(self) -> SceneFile:
        """The scene as `phantomgen.scene` reads it."""
        keys = [key.name for key in fields(self) if key.name != "folder" and getattr(self, key.name) is not None]
        given: dict[str, Any] = {"version": 1} | {
            key: getattr(self, key) for key in keys if key not in {"objects", "materials"}
        }
        if self.materials:
            given["materials"] = {name: _material(value) for name, value in self.materials.items()}
        given["objects"] = [value.values if isinstance(value, Described) else value for value in self.objects]
        name = str(Path(self.folder, self.name))
        values = completed(plain(given), name)
        return SceneFile(name, "", given={key: values[key] for key in SceneModel.model_fields if key in values})

    @property
    def yaml(self) -> str:
        """Text of a scene file that says the same."""
        return scene_text(self.file.template)

    def __str__(self) -> str:
        return self.yaml

    def __repr__(self) -> str:
        return f"Scene({self.name}: {len(self.objects)} objects)"

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Scene) and self.file.model == other.file.model

    __hash__ = None  # type: ignore[assignment]  # it holds mappings

    def save(self, path: Path | str, *, overwrite: bool = False) -> Path:
        """Write a scene file.

        Parameters
        ----------
        path : the file
        overwrite : replace a file that exists

        Returns
        -------
        path
        """
        path = Path(path)
        check_output(path, overwrite)
        path.write_text(self.yaml, encoding="utf-8")
        return path

    def changed(self, overrides: Overrides) -> "Scene":
        """Return the scene with other values.

        Parameters
        ----------
        overrides : values by dotted path, such as ``{"geometry.views": 30}``, or texts ``path=value``

        Returns
        -------
        the scene
        """
        return self._of(self.file.changed(overrides), self.folder)

    @cached_property
    def scan(self) -> Scan:
        """Return the scan that `phantomgen.make` simulates."""
        return load_scene(self.file)

    def voxelize(self, grid: Grid | None = None) -> Truth:
        """Compute exact material fractions and basis volumes of voxels.

        Parameters
        ----------
        grid : the voxels; those of the section ``volume`` where left out

        Returns
        -------
        the truth, with `volumes` [1/mm], `fractions` and `labels`
        """
        return scan_truth(self.scan if grid is None else replace(self.scan, grid=grid))

    def path_lengths(
        self, starts: Real[np.ndarray, "ray 3"], ends: Real[np.ndarray, "ray 3"]
    ) -> Float[np.ndarray, "ray material"]:
        """Compute exact path lengths of rays in each material.

        Parameters
        ----------
        starts, ends : first and last points of the rays (x, y, z) [mm], (ray, 3)

        Returns
        -------
        lengths [mm], in the order of ``scan.scene.materials``

        Raises
        ------
        InputError
            When the points are no rows of three finite numbers.
        """
        first, last = (np.atleast_2d(np.asarray(points, dtype=np.float64)) for points in (starts, ends))
        if not (first.shape == last.shape and first.shape[1:] == (3,) and np.isfinite([first, last]).all()):
            raise InputError(
                f"rays need starts and ends of equal shape (ray, 3), finite [mm], got {first.shape} and {last.shape}"
            )
        return self.scan.scene.path_lengths(first, last - first)

    def line_integrals(
        self,
        starts: Real[np.ndarray, "ray 3"],
        ends: Real[np.ndarray, "ray 3"],
        energy: float | Sequence[float] | None = None,
    ) -> Float[np.ndarray, "ray part"]:
        """Compute exact line integrals of rays: of each basis volume, or of the attenuation at energies.

        Parameters
        ----------
        starts, ends : first and last points of the rays (x, y, z) [mm], (ray, 3)
        energy : photon energies [keV]; None for the basis volumes

        Returns
        -------
        line integrals [no unit], (ray, basis) or (ray, energy)
        """
        lengths = self.path_lengths(starts, ends)
        if energy is None:
            return lengths @ material_coefficients(self.scan)
        energies = np.atleast_1d(np.asarray(energy, dtype=np.float64))
        curves = [m.attenuation(energies, self.scan.basis) for m in self.scan.scene.materials]
        return lengths @ np.stack(curves)


def _material(value: Section | Material) -> Any:
    """A material as a scene file has it."""
    if not isinstance(value, Material):
        return value
    if value.coefficients is not None:
        return {"coefficients": dict(value.coefficients)}
    return {"composition": value.composition, "density": value.density}
