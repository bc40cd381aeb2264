"""From a scene file to what `simulate` runs: objects, materials, geometry, source, detector and basis."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

from phantomgen.effects import Effects
from phantomgen.effects.tube_fluctuation import CurrentModulation
from phantomgen.geometry.curved_panel import flat_modules
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.scene import schema
from phantomgen.scene.basis import needed, scene_basis
from phantomgen.scene.beam_profile import Profile
from phantomgen.scene.detector import has_cumulative_counters, has_pile_up, scene_dead_time, scene_detector
from phantomgen.scene.effects import scene_effects
from phantomgen.scene.file.find_scene import find_scene
from phantomgen.scene.file.scene_file import Overrides, SceneFile, closest
from phantomgen.scene.geometry import SceneGeometry, scene_geometry
from phantomgen.scene.materials import check_material, inflow_peaks, scene_materials
from phantomgen.scene.objects.build import BuiltObject, ObjectContent, has_curves, objects_of
from phantomgen.scene.objects.overlap import added_up
from phantomgen.scene.scene_objects import SceneObjects
from phantomgen.scene.source import beam_profile_of, modulation_of, source_fields, sources_of
from phantomgen.shapes import Shape
from spectra.basis.basis import Basis
from spectra.detector.dead_time import DeadTime
from spectra.detector.detector import AnyDetector, Detector
from spectra.detector.multi_source import MultiSource, added
from spectra.detector.pile_up import pulse_detector
from spectra.source.source import Source

if TYPE_CHECKING:
    from phantomgen.scene.dynamics.dynamics import Dynamics


@dataclass(frozen=True, eq=False)
class Scan:
    """Everything that `simulate` requires.

    Parameters
    ----------
    name : of the scene
    scene : what is scanned
    geometry : poses of all views, training views first
    splits : indices of the views in ``train``, ``test`` and ``val``
    source, detector : photons, and the channels that count them
    basis : raw basis functions that the scene needs
    grid : voxels of the truth and of the volume to reconstruct
    seed, noise : key of the Poisson noise, and whether there is any
    flats, darks : number of open-beam frames and of frames without beam
    source_fields : what a file says about the tube, as (value, unit)
    text : the resolved scene as YAML
    sub_rays : rays along each edge of a pixel, None where pixels are split along silhouettes
    exposure : photons of each view and channel, relative to those of the source; None where all are 1
    modulation : of the tube current from view to view; None where all views have the same
    profile : how the beam differs over the panel, None where it does not
    dead_time : of the detector's pixels, None where every event is recorded
    effects : what a real scan has beyond exposure and photon noise
    file : the scene that it was read from, where smooth surfaces may become finer triangles; else None
    nominal : poses that a reconstructor is given; None where they are those of `geometry`, which are simulated
    sample_poses : where a sample that moves is in each view, as matrices [mm]; None where it rests
    dynamics : objects that move and materials that change in time; None where all rest
    cumulative : whether the dataset has counts above thresholds, in place of those between them
    pulses : the detector with a channel for each group of pulse heights, where heights in a dead time add; else None
    """

    name: str
    scene: SceneObjects
    geometry: Geometry
    splits: Mapping[str, Int[np.ndarray, " _view"]]
    source: Source
    detector: AnyDetector
    basis: Basis
    grid: Grid
    seed: int
    noise: bool
    flats: int
    darks: int
    source_fields: Mapping[str, tuple[float | str, str | None]]
    text: str
    sub_rays: int | None = None
    exposure: Float[np.ndarray, "view channel"] | None = None
    modulation: CurrentModulation | None = None
    profile: Profile | None = None
    dead_time: DeadTime | None = None
    effects: Effects = field(default_factory=Effects)
    file: SceneFile | None = None
    nominal: Geometry | None = None
    sample_poses: Float[np.ndarray, "view 4 4"] | None = None
    dynamics: "Dynamics | None" = None
    cumulative: bool = False
    pulses: Detector | None = None

    def __repr__(self) -> str:
        objects, channels = len(self.scene.objects), len(self.detector)
        return f"Scan({self.name}: {objects} objects, {self.geometry!r}, {channels} channels, basis {self.basis.names})"

    def tessellated(self, fineness: int) -> "Scan":
        """Return the scan with smooth surfaces of finer triangles.

        Parameters
        ----------
        fineness : how many times finer than usual

        Returns
        -------
        the scan; unchanged where it was not read from a scene file
        """
        if self.file is None:
            return self
        return load_scene(replace(self.file, overrides=(*self.file.overrides, f"tessellation={fineness}")))

    @property
    def aperture(self) -> tuple[float, float]:
        """Width and height of the sensitive part of pixels [pixel]."""
        aperture = self.effects.aperture
        return (1.0, 1.0) if aperture is None else (aperture.width, aperture.height)

    @property
    def profile_lengths(self) -> Float[np.ndarray, "part row column"] | None:
        """Path lengths of the rays to each pixel in what shapes the beam [mm]; None where the beam is even."""
        return None if self.profile is None else self.profile.lengths

    def view_profile(self, view: int) -> Float[np.ndarray, "part row column"] | None:
        """Return the part of `profile_lengths` that a view sees, which of `by_module` is that of one module.

        Parameters
        ----------
        view : number of the view

        Returns
        -------
        path lengths [mm]; None where the beam is even
        """
        lengths, columns = self.profile_lengths, self.geometry.panel.columns
        if lengths is None or lengths.shape[2] == columns:
            return lengths
        first = view % (lengths.shape[2] // columns) * columns
        return np.ascontiguousarray(lengths[:, :, first : first + columns])

    @cached_property
    def by_module(self) -> "Scan":
        """The scan with each module of a curved panel as a view of its own; itself where the panel is flat."""
        flat = flat_modules(self.geometry)
        if flat is self.geometry:
            return self
        time = None if self.dynamics is None else self.dynamics.by_module(self.geometry.panel.modules)
        return replace(self, geometry=flat, dynamics=time)

    def instant(self, view: int) -> "Scan":
        """Return the scan with its objects where they are in the middle of a view's exposure.

        Parameters
        ----------
        view : number of the view

        Returns
        -------
        the scan without `dynamics`; itself where it has none
        """
        return self if self.dynamics is None else self.at_time(float(self.dynamics.times[view]))

    def at_time(self, time: float) -> "Scan":
        """Return the scan with its objects where they are at a time.

        Parameters
        ----------
        time : [s]

        Returns
        -------
        the scan without `dynamics`; itself where it has none
        """
        return self if self.dynamics is None else _at_time(self, time)

    @property
    def scheme(self) -> str:
        """Name of the split of views, such as ``sparse75``."""
        return f"sparse{len(self.splits['train'])}"


@lru_cache(maxsize=4)
def _at_time(scan: Scan, time: float) -> Scan:
    """A scan at one instant, kept for as long as a few others are not asked for."""
    assert scan.dynamics is not None
    return replace(scan, scene=scan.dynamics.at(scan.scene, time), dynamics=None)


def load_scene(scene: str | Path | SceneFile, overrides: Overrides = ()) -> Scan:
    """Read a scene file or preset and create its scan.

    Parameters
    ----------
    scene : path of a scene file, or name of a preset
    overrides : values by dotted paths, as ``{"geometry.views": 180}`` or as texts ``geometry.views=180``

    Returns
    -------
    the scan

    Raises
    ------
    SceneError
        With file, line, column and key of what is wrong.
    """
    file = scene.changed(overrides) if isinstance(scene, SceneFile) else find_scene(scene).changed(overrides)
    model = file.model
    built = objects_of(file)
    objects: Sequence[tuple[Shape, ObjectContent]] = [(item.shape, item.content) for item in built]
    source, detector = _source_and_detector(file)
    background = _background(file)
    if model.overlap == "add":
        if model.time is not None:
            raise file.error(("time",), "objects that add up cannot move or change: use 'overlap: replace'")
        objects, materials = added_up(file, objects)
        filled = _material_names(objects, background)
    else:
        filled = _material_names(objects, background)
        filled += inflow_peaks(file, filled)
        materials = scene_materials(file, filled)
    used = [name for name in materials if name in filled]
    basis = scene_basis(file, materials, used, source, detector)
    _check_coefficients(file, basis)
    geometry = scene_geometry(file)
    return Scan(
        name=model.name,
        scene=SceneObjects(
            objects=tuple((shape, _indices(content, used)) for shape, content in objects),
            materials=tuple(materials[name] for name in used),
            background=-1 if background is None else used.index(background),
        ),
        geometry=geometry.true,
        splits=geometry.splits,
        source=source,
        detector=detector,
        basis=needed(basis, [materials[name] for name in used]),
        grid=model.volume.grid,
        seed=model.seed,
        noise=model.noise,
        flats=model.flats,
        darks=model.darks,
        source_fields=source_fields(file),
        text=file.resolved,
        sub_rays=model.panel.sub_rays,
        exposure=_exposure(file, geometry.splits, detector),
        modulation=modulation_of(file),
        profile=beam_profile_of(file, source),
        dead_time=scene_dead_time(file),
        effects=scene_effects(file),
        file=file if model.tessellation == "auto" and has_curves(file) else None,
        nominal=geometry.nominal,
        sample_poses=geometry.sample,
        dynamics=None if model.time is None else _dynamics(file, geometry, built, used),
        cumulative=has_cumulative_counters(file),
        pulses=_pulses(file, detector),
    )


def _dynamics(
    file: SceneFile, geometry: SceneGeometry, built: Sequence[BuiltObject], used: list[str]
) -> "Dynamics | None":
    """The time of a scene that states one."""
    from phantomgen.scene.dynamics.build import scene_dynamics  # noqa: PLC0415 - only where something changes

    motions = tuple(item.motions for item in built)
    return scene_dynamics(file, geometry.times, geometry.splits["train"], motions, used)


def _pulses(file: SceneFile, detector: AnyDetector) -> Detector | None:
    """The groups of pulse heights, where these add; only counters have it."""
    return pulse_detector(detector) if has_pile_up(file) and isinstance(detector, Detector) else None


def _material_names(objects: Sequence[tuple[Shape, ObjectContent]], background: str | None) -> list[str]:
    """Names of the materials that an object or the background consists of, each once."""
    names = [name for _, content in objects for name in _names(content)]
    return list(dict.fromkeys([*names, *([] if background is None else [background])]))


def _names(content: ObjectContent) -> tuple[str, ...]:
    """Names of an object's materials."""
    return content if isinstance(content, tuple) else (content,)


def _indices(content: ObjectContent, used: list[str]) -> int | tuple[int, ...]:
    """Indices of an object's materials."""
    return tuple(map(used.index, content)) if isinstance(content, tuple) else used.index(content)


def _source_and_detector(file: SceneFile) -> tuple[Source, AnyDetector]:
    """Create the source and the detector of a scene."""
    sources = sources_of(file)
    detectors = tuple(scene_detector(file, source) for source in sources.values())
    if len(sources) == 1:
        return next(iter(sources.values())), detectors[0]
    return added(tuple(sources.values())), MultiSource.of(sources, detectors)


def _background(file: SceneFile) -> str | None:
    """Name of the material around the objects."""
    name = file.model.background
    if name is not None:
        check_material(file, name, ("background",))
    if name is not None and isinstance(file.model.geometry, schema.ParallelModel):
        raise file.error(
            ("background",), "a parallel beam has no source to reach from: put a box of it around the objects"
        )
    return name


def _check_coefficients(file: SceneFile, basis: Basis) -> None:
    """Refuse coefficients of functions that are not in the basis, also of materials that no object uses."""
    for name, material in file.model.materials.items():
        for function in material.coefficients or ():
            if function not in basis.names:
                raise file.error(
                    ("materials", name, "coefficients", function),
                    f"there is no basis function {function!r}{closest(function, basis.names)}",
                )


def _exposure(
    file: SceneFile, splits: Mapping[str, Int[np.ndarray, " _view"]], detector: AnyDetector
) -> Float[np.ndarray, "view channel"] | None:
    """Exposure of views that sources take in turn, training and test views each from the first source on."""
    if not isinstance(detector, MultiSource) or file.model.source.type != "switching":
        return None
    order = np.concatenate([np.arange(len(views)) for views in splits.values()])
    turn = order % len(detector.sources)
    return (turn[:, None] == np.asarray(detector.groups)).astype(np.float64)
