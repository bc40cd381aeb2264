"""CTSimU: a metadata file of projections, real or simulated, and the scenario that says where they were taken.

References
----------
.. [1] https://bamresearch.github.io/ctsimu-scenarios, format 1.2.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from phantomgen.geometry.poses import Geometry
from phantomgen.importers.files.images import Stack, raw_stack, tiff_stack
from phantomgen.importers.readers.ctsimu_poses import number, scenario_geometry, unknown_parts
from phantomgen.importers.readers.turntable import as_stored, in_order
from phantomgen.importers.scans.raw_scan import Frames, Image, RawScan
from phantomgen.importers.scans.stated import Stated
from spectra.elements.attenuation import natural_density
from spectra.errors import Error, GeometryError, InputError

_LARGEST = 64 << 20  # bytes of JSON
_KINDS = {"uint8": "u1", "int8": "i1", "uint16": "u2", "int16": "i2", "float32": "f4", "float64": "f8"}


def read(paths: Sequence[Path], stated: Stated) -> RawScan:
    """Read a scan.

    Parameters
    ----------
    paths : one metadata file
    stated : facts that the user states

    Returns
    -------
    the scan

    Raises
    ------
    InputError
        When a file is missing or damaged, or lacks a key.
    """
    path = paths[0]
    metadata = _json(path, "CTSimU Metadata")
    scenario_path, scenario = _scenario(path, metadata)
    try:
        geometry = scenario_geometry(scenario)
        facts, notes = _facts(scenario_path, scenario)
    except (Error, AttributeError, TypeError, OverflowError) as error:
        said = error if isinstance(error, Error) else "a mapping is expected where another value stands"
        raise InputError(f"{scenario_path}: {said}") from None
    output = metadata.get("output")
    projections = output.get("projections") if isinstance(output, dict) else None
    if not isinstance(projections, dict):
        raise InputError(f"{path}: the key output.projections is missing")
    shape = geometry.panel.rows, geometry.panel.columns
    stack = _stack(path, projections, projections, shape)
    if len(stack) != len(geometry):
        raise InputError(f"{path}: there are {len(stack)} projections, the scenario has {len(geometry)}")
    fields = {name: _frames(path, projections, f"{name}_field", shape) for name in ("flat", "dark")}
    gray = (scenario.get("detector") or {}).get("gray_value") or {}
    if fields["flat"] is None:
        most = projections.get("max_intensity")
        facts["white"] = float(most) if isinstance(most, int | float) and most > 0 else None
        lowest = number(gray, "imin", default=0.0)
        if fields["dark"] is None and lowest > 0:
            fields["dark"] = np.full((1, 1, *shape), lowest, np.float32)
    geometry, turned = _seen_from_source(geometry)

    def image(view: int) -> Image:
        return stack[view][None, :, :: -1 if turned else 1]

    frames = {
        name: None if f is None else in_order(f[..., :: -1 if turned else 1], stated) for name, f in fields.items()
    }
    name = (scenario.get("file") or {}).get("name") if isinstance(scenario.get("file"), dict) else None
    return RawScan(
        path=path,
        title=str(name or path.stem),
        values="readings",
        channels=("signal",),
        geometry=geometry,
        image=as_stored(image, stated),
        stated=stated.completed(facts),
        flats=frames["flat"],
        darks=frames["dark"],
        notes=tuple(notes),
    )


def _json(path: Path, kind: str) -> dict[str, Any]:
    """Content of a JSON file of CTSimU."""
    if not path.is_file():
        raise InputError(f"there is no file {path}")
    try:
        if path.stat().st_size > _LARGEST:
            raise ValueError
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        raise InputError(f"{path} cannot be read: it is not JSON") from None
    file = content.get("file") if isinstance(content, dict) else None
    found = file.get("file_type") if isinstance(file, dict) else None
    if found != kind:
        raise InputError(f"{path} is no {kind} file: file.file_type is {found!r}; name the metadata of the projections")
    return content


def _scenario(path: Path, metadata: Mapping[str, Any]) -> tuple[Path, dict[str, Any]]:
    """The scenario that the metadata names, else the one that a simulator put into it."""
    named = metadata.get("acquisition_geometry")
    place = named.get("path_to_CTSimU_JSON") if isinstance(named, dict) else None
    if place and (path.parent / str(place)).is_file():
        return path.parent / str(place), _json(path.parent / str(place), "CTSimU Scenario")
    simulation = metadata.get("simulation")
    inside = simulation.get("ctsimu_scenario") if isinstance(simulation, dict) else None
    if isinstance(inside, dict):
        return path, inside
    raise InputError(f"{path}: the scenario acquisition_geometry.path_to_CTSimU_JSON, {place!r}, is not there")


def _facts(path: Path, scenario: Mapping[str, Any]) -> tuple[dict[str, Any], list[str]]:
    """Facts that the scenario states, and what is taken to be so."""
    source, detector = scenario.get("source") or {}, scenario.get("detector") or {}
    spectrum, notes = source.get("spectrum") or {}, []
    stated = (source.get("voltage") or {}).get("value")
    voltage = None if stated is None else number({"voltage": {"value": stated}}, "voltage")
    file = (spectrum.get("file") or {}).get("value") if isinstance(spectrum.get("file"), dict) else None
    facts: dict[str, Any] = {"scintillator": _layers(scenario, [detector.get("scintillator") or {}])}
    if file:
        facts |= {"spectrum": path.parent / str(file), "filters": _layers(scenario, source.get("filters") or [])}
    elif spectrum.get("monochromatic"):
        facts["energy"] = voltage
    else:
        sheets = [*(source.get("window") or []), *(source.get("filters") or [])]
        facts |= {"kvp": voltage, "filters": _layers(scenario, sheets) if "filters" in source else None}
    if facts["scintillator"] is None:
        facts["scintillator"] = "CsI"
        notes.append("the panel was taken as a CsI scintillator")
    ratio = ((detector.get("noise") or {}).get("snr_at_imax") or {}).get("value")
    if isinstance(ratio, int | float) and ratio > 0:
        facts["photons"] = float(ratio) ** 2
        notes.append(f"photons per pixel are the square of snr_at_imax, {ratio:g}")
    if unknown_parts(scenario):
        notes.append("deviations and drifts that are not known to the reconstruction were left out of the poses")
    return facts, notes


def _layers(scenario: Mapping[str, Any], layers: Sequence[Any]) -> str | None:
    """Layers of materials of known density, as text; None where there is another, or no thickness."""
    known = {one.get("id"): one.get("composition") for one in scenario.get("materials") or () if isinstance(one, dict)}
    found = []
    for layer in layers:
        composition = known.get(layer.get("material_id"))
        if not isinstance(composition, list) or len(composition) != 1 or not layer.get("thickness"):
            return None
        formula = (composition[0].get("formula") or {}).get("value")
        if not isinstance(formula, str) or natural_density(formula) is None:
            return None
        found.append(f"{number(layer, 'thickness'):g} mm {formula}")
    return " + ".join(found) or "none"


def _stack(path: Path, entry: Mapping[str, Any], projections: Mapping[str, Any], shape: tuple[int, int]) -> Stack:
    """Images of an entry that names files by a pattern such as ``scan_%04d.tif``, or one file of all."""
    pattern, count = entry.get("filename"), entry.get("number")
    if not isinstance(pattern, str) or not isinstance(count, int) or not 1 <= count <= 1_000_000:
        raise InputError(f"{path}: projections need a filename and a number, got {pattern!r} and {count!r}")
    try:
        names = [pattern % i for i in range(count)] if "%" in pattern else [pattern]
    except (TypeError, ValueError):
        raise InputError(f"{path}: filename {pattern!r} is no pattern such as scan_%04d.tif") from None
    files = [path.parent / name for name in names]
    if any(not file.resolve().is_relative_to(path.parent.resolve()) for file in files):
        raise InputError(f"{path}: filename {pattern!r} leads out of the folder")
    if Path(pattern).suffix.lower() in (".tif", ".tiff"):
        return tiff_stack(files, shape)
    kind = _KINDS.get(str(projections.get("datatype")))
    header = projections.get("headersize") or {}
    if kind is None or any(header.values()):
        raise InputError(f"{path}: raw files are read with one of the types {', '.join(_KINDS)} and without a header")
    dtype = (">" if projections.get("byteorder") == "big" else "<") + kind
    per_file = count if len(files) == 1 else 1
    stacks = [raw_stack(file, per_file, shape, dtype) for file in files]
    return Stack(shape, tuple(read for stack in stacks for read in stack.images))


def _frames(path: Path, projections: Mapping[str, Any], name: str, shape: tuple[int, int]) -> Frames | None:
    """Flats or darks, where there are any that were not applied already."""
    entry = projections.get(name)
    if not isinstance(entry, dict) or not entry.get("number") or not entry.get("filename"):
        return None
    if entry.get("projections_corrected"):
        return None
    return _stack(path, entry, projections, shape).all()[:, None]


def _seen_from_source(geometry: Geometry) -> tuple[Geometry, bool]:
    """Count columns so that the panel is seen from the source; the second value says whether they were reversed."""
    away = np.einsum("vi,vi->v", geometry.panel_center - geometry.source, geometry.normals())
    if (away > 0).all():
        return geometry, False
    if not (away < 0).all():
        raise GeometryError("some views see the panel from its front and others from its back")
    return replace(geometry, column_step=-geometry.column_step), True
