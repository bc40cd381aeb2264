"""DICOM-CT-PD: one file per view of log projections, of clinical scanners with a curved detector or of a flat panel.

A curved detector is centred on the focal spot where that is not deflected. Angles are those of the format's manual,
where the source of angle phi stands at (-rho sin phi, rho cos phi). The order of rows and columns has not been compared
with a scanner: ``--mirror``, ``--flip-rows`` and ``--reverse`` change it.

References
----------
.. [1] Chen et al. 2015, doi:10.1117/12.2070931; Moen et al. 2021, doi:10.1002/mp.14594, table IV.
"""

import struct
from collections.abc import Sequence
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from phantomgen.geometry.curved_panel import shifted_along
from phantomgen.geometry.panel import Curvature, Panel, module_columns
from phantomgen.geometry.poses import Geometry
from phantomgen.importers.readers.channel_names import clean
from phantomgen.importers.readers.turntable import as_stored
from phantomgen.importers.scans.raw_scan import Image, RawScan
from phantomgen.importers.scans.stated import Stated
from spectra.errors import InputError, NotInstalledError

_KINDS = {"FL": "<f4", "US": "<u2"}
_TAGS = {  # name: tag, kind of number
    "rows": ((0x7029, 0x1010), "US"),
    "columns": ((0x7029, 0x1011), "US"),
    "column_pitch": ((0x7029, 0x1002), "FL"),
    "row_pitch": ((0x7029, 0x1006), "FL"),
    "phi": ((0x7031, 0x1001), "FL"),
    "z": ((0x7031, 0x1002), "FL"),
    "rho": ((0x7031, 0x1003), "FL"),
    "sdd": ((0x7031, 0x1031), "FL"),
    "central": ((0x7031, 0x1033), "FL"),
}
_SHIFTS = {"dphi": (0x7033, 0x100B), "dz": (0x7033, 0x100C), "drho": (0x7033, 0x100D)}
_SHAPE, _PHOTONS, _SPECTRUM = (0x7029, 0x100B), (0x7033, 0x1065), (0x7033, 0x1063)
_PUBLIC = {"kvp": (0x0018, 0x0060), "instance": (0x0020, 0x0013)}
_SHAPES = ("CYLINDRICAL", "FLAT")
_MOST_FAN = 1.4  # rad; largest angle between the central ray and a ray that is believed
_MOST = 4096  # rows or columns of a detector that are believed


class _View(NamedTuple):
    """What a file says but for its image."""

    path: Path
    numbers: dict[str, Float[np.ndarray, " n"]]
    shape: str
    photons: float | None
    spectrum: int
    order: int
    kvp: float | None


def read(paths: Sequence[Path], stated: Stated) -> RawScan:
    """Read a scan.

    Parameters
    ----------
    paths : folders; each is a channel, or all spectra are in one
    stated : facts that the user states

    Returns
    -------
    the scan

    Raises
    ------
    InputError
        When a file is damaged, lacks a tag, or is of another detector than the others.
    NotInstalledError
        When pydicom is not there.
    """
    try:
        import_module("pydicom")
    except ImportError:
        raise NotInstalledError("reading DICOM-CT-PD needs pydicom: pip install 'spectral-ct[dicom]'") from None
    found = [channel for path in paths for channel in _channels(path)]
    views = found[0]
    for other in found[1:]:
        if len(other) != len(views) or any(
            not np.allclose(a.numbers[name], b.numbers[name], rtol=0, atol=1e-4)
            for a, b in zip(other, views, strict=True)
            for name in ("phi", "z", "rho")
        ):
            raise InputError(f"{other[0].path.parent}: its views are not those of {views[0].path.parent}")
    first = views[0]
    _check_alike(views)
    photons = [view.photons for view in views if view.photons is not None]
    facts = {"kvp": first.kvp, "scintillator": "GOS", "photons": float(np.median(photons)) if photons else None}
    rows, columns = (int(first.numbers[name][0]) for name in ("rows", "columns"))
    detector = _Detector.of(first, rows, columns)
    names = tuple(f"bin{i}" for i in range(len(found))) if len(found) > 1 else ("signal",)
    if len(paths) == len(found) > 1:
        names = tuple(clean(path.name) for path in paths)

    def image(view: int) -> Image:
        return np.stack([_pixels(channel[view].path, rows, columns) for channel in found])

    return RawScan(
        path=paths[0],
        title=paths[0].resolve().name,
        values="line-integrals",
        channels=names,
        geometry=_geometry(views, detector, stated),
        image=as_stored(image, stated),
        stated=stated.completed(facts),
        notes=(
            "the detector was taken as a GOS scintillator" if len(found) == 1 else "views of all spectra were joined",
            *((f"photons per pixel are the median of PhotonStatistics, {facts['photons']:g}",) if photons else ()),
            "rows and columns were taken in the order of the file: --mirror, --flip-rows and --reverse change that",
        ),
    )


class _Detector(NamedTuple):
    """The detector.

    Parameters
    ----------
    panel : its pixels
    center : place of its middle along columns and rows from where the central ray meets it [mm], along the cylinder
        where it is curved
    sdd : distance [mm]
    """

    panel: Panel
    center: tuple[float, float]
    sdd: float

    @classmethod
    def of(cls, view: _View, rows: int, columns: int) -> "_Detector":
        """Describe the detector of a view; the central element counts from 1."""
        pitch = float(view.numbers["row_pitch"][0]), float(view.numbers["column_pitch"][0])
        sdd = float(view.numbers["sdd"][0])
        column0, row0 = view.numbers["central"] - 1
        middle = ((columns - 1) / 2 - column0) * pitch[1], ((rows - 1) / 2 - row0) * pitch[0]
        panel = Panel(rows, columns, pitch)
        if view.shape == "CYLINDRICAL":
            fan = max(column0 + 0.5, columns - 0.5 - column0) * pitch[1] / sdd
            if fan > _MOST_FAN:
                raise InputError(f"{view.path}: the fan of {np.rad2deg(fan):.0f} degrees is no fan of a scanner")
            panel = replace(panel, curvature=Curvature(sdd, columns // module_columns(panel, sdd)))
        return cls(panel, (float(middle[0]), float(middle[1])), sdd)


def _geometry(views: Sequence[_View], detector: _Detector, stated: Stated) -> Geometry:
    """Poses; the panel faces the focal spot's place without its shift."""
    phi, z, rho = (np.array([view.numbers[name][0] for view in views]) for name in ("phi", "z", "rho"))
    dphi, dz, drho = (np.array([view.numbers[name][0] for view in views]) for name in _SHIFTS)
    if stated.reverse:
        phi, dphi = -phi, -dphi
    zero, one = np.zeros_like(phi), np.ones_like(phi)
    source = np.stack([-(rho + drho) * np.sin(phi + dphi), (rho + drho) * np.cos(phi + dphi), z + dz], axis=1)
    focus = np.stack([-rho * np.sin(phi), rho * np.cos(phi), z], axis=1)
    ray = np.stack([np.sin(phi), -np.cos(phi), zero], axis=1)
    along, down = np.stack([-np.cos(phi), -np.sin(phi), zero], axis=1), np.stack([zero, zero, -one], axis=1)
    center = focus + detector.sdd * ray + detector.center[1] * down
    panel = detector.panel
    kind = "helical" if np.ptp(z) > 1e-3 else "circular"
    steps = panel.column_pitch * along, panel.row_pitch * down
    return shifted_along(Geometry(source, center, *steps, panel, phi + np.pi / 2, kind), detector.center[0])


def _channels(folder: Path) -> list[list[_View]]:
    """Views of each spectrum in a folder, in the order of their numbers."""
    if not folder.is_dir():
        raise InputError(f"{folder} is no folder of DICOM-CT-PD files")
    paths = sorted(path for path in folder.iterdir() if path.is_file() and path.suffix.lower() in (".dcm", ".ima", ""))
    if not paths:
        raise InputError(f"{folder} has no file .dcm")
    views = sorted((_view(path) for path in paths), key=lambda view: view.order)
    numbers = sorted({view.spectrum for view in views})
    return [[view for view in views if view.spectrum == number] for number in numbers]


def _check_alike(views: Sequence[_View]) -> None:
    """Refuse views of different detectors."""
    for view in views[1:]:
        for name in ("rows", "columns", "column_pitch", "row_pitch", "sdd", "central"):
            if not np.allclose(view.numbers[name], views[0].numbers[name], rtol=1e-5):
                raise InputError(f"{view.path}: {name} differs from that of {views[0].path}")


def _opened(path: Path, pixels: bool) -> Any:
    """A data set of pydicom; whatever it makes of a damaged file becomes a sentence."""
    try:
        return import_module("pydicom").dcmread(path, stop_before_pixels=not pixels)
    except Exception:
        raise InputError(f"{path} cannot be read: it is no DICOM file, or cut off") from None


def _values(path: Path, data: Any) -> dict[Any, Any]:
    """Values of the tags that are read; pydicom decodes them when they are asked for."""
    wanted = [*(tag for tag, _ in _TAGS.values()), *_SHIFTS.values(), _SHAPE, _PHOTONS, _SPECTRUM, *_PUBLIC.values()]
    try:
        return {tag: data[tag].value for tag in wanted if tag in data}
    except Exception:
        raise InputError(f"{path} cannot be read: a tag is damaged or cut off") from None


def _view(path: Path) -> _View:
    """Read what a file says but for its image."""
    data = _values(path, _opened(path, pixels=False))
    numbers = {name: _numbers(path, data, tag, kind, name) for name, (tag, kind) in _TAGS.items()}
    numbers |= {
        name: _numbers(path, data, tag, "FL", name) if tag in data else np.zeros(1) for name, tag in _SHIFTS.items()
    }
    if len(numbers["central"]) != 2:
        raise InputError(f"{path}: DetectorCentralElement must be two numbers")
    if max(numbers["rows"][0], numbers["columns"][0]) > _MOST or min(numbers["rows"][0], numbers["columns"][0]) < 1:
        raise InputError(
            f"{path}: a detector of {numbers['rows'][0]:g} x {numbers['columns'][0]:g} is not to be believed"
        )
    for name in ("column_pitch", "row_pitch", "sdd", "rho"):
        if not numbers[name][0] > 0:
            raise InputError(f"{path}: {name} must be positive, got {numbers[name][0]:g}")
    shape = _text(data, _SHAPE) or "CYLINDRICAL"
    if shape not in _SHAPES:
        raise InputError(f"{path}: DetectorShape is {shape}, and only {' and '.join(_SHAPES)} are read")
    photons = _numbers(path, data, _PHOTONS, "FL", "PhotonStatistics").mean() if _PHOTONS in data else None
    spectrum = int(_numbers(path, data, _SPECTRUM, "US", "SpectrumIndex")[0]) if _SPECTRUM in data else 1
    kvp, order = (_numbers(path, data, tag, "DS", name)[0] if data.get(tag) else None for name, tag in _PUBLIC.items())
    mean = None if photons is None else float(photons)
    return _View(path, numbers, shape, mean, spectrum, int(order or 0), None if kvp is None else float(kvp))


def _numbers(path: Path, data: dict[Any, Any], tag: tuple[int, int], kind: str, name: str) -> Float[np.ndarray, " n"]:
    """Numbers of a private tag, which pydicom gives as bytes where it does not know their kind."""
    if tag not in data:
        raise InputError(f"{path}: the tag ({tag[0]:04X},{tag[1]:04X}), {name}, is missing")
    value = data[tag]
    try:
        if isinstance(value, bytes):
            value = np.frombuffer(value, _KINDS.get(kind, "<f4"))
        numbers = np.ravel(np.asarray(value, dtype=np.float64))
    except (ValueError, TypeError, struct.error):
        numbers = np.empty(0)
    if not len(numbers) or not np.isfinite(numbers).all():
        raise InputError(f"{path}: the tag ({tag[0]:04X},{tag[1]:04X}), {name}, holds no number")
    return numbers


def _text(data: dict[Any, Any], tag: tuple[int, int]) -> str:
    value = data.get(tag, "")
    return (value.decode(errors="replace") if isinstance(value, bytes) else str(value)).strip("\0 ")


def _pixels(path: Path, rows: int, columns: int) -> Float[np.ndarray, "row column"]:
    """Log projections of a file; scanners store them with rows and columns in either order."""
    data = _opened(path, pixels=True)
    try:
        stored = np.asarray(data.pixel_array, dtype=np.float64)
        image = stored * float(data.get("RescaleSlope", 1.0)) + float(data.get("RescaleIntercept", 0.0))
    except Exception:
        raise InputError(f"{path} cannot be read: its pixels are missing, damaged or cut off") from None
    if image.shape == (columns, rows) and rows != columns:
        image = image.T
    if image.shape != (rows, columns):
        raise InputError(f"{path} has {image.shape} pixels, its tags say ({rows}, {columns})")
    return image
