"""Geometry files of RTK (``RTKThreeDCircularGeometry``)."""

from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from phantomgen.geometry.conversions.rtk import RtkGeometry, from_rtk, rtk_matrices
from phantomgen.geometry.panel import Panel
from phantomgen.geometry.poses import Geometry
from spectra.errors import Error, InputError

_ROOT = "RTKThreeDCircularGeometry"
_RADIUS = "RadiusCylindricalDetector"
_NAMES = tuple(name for name in RtkGeometry.__dataclass_fields__ if name != _RADIUS)
_SAME = 1e-3  # relative; a matrix of the file may differ so much from the one that its numbers give


def read_rtk_geometry(path: Path, panel: Panel) -> Geometry:
    """Read poses.

    Parameters
    ----------
    path : file of RTK, version 3
    panel : the pixel grid, which RTK keeps with the projections

    Returns
    -------
    poses of all views

    Raises
    ------
    InputError
        When the file cannot be read, is of another kind, holds something that is no number, has a panel with a
        different radius in some view, or its matrices contradict its numbers.
    """
    try:
        root = ElementTree.fromstring(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path} cannot be read as a geometry of RTK: {error.strerror}") from None
    except (ElementTree.ParseError, UnicodeDecodeError):
        raise InputError(f"{path} cannot be read as a geometry of RTK: it is not XML") from None
    version = root.get("version")
    if root.tag != _ROOT or version != "3":
        raise InputError(
            f"{path} is no geometry of RTK: it begins with {root.tag} version {version}, not {_ROOT} version 3"
        )
    views = root.findall("Projection")
    if not views:
        raise InputError(f"{path} holds no Projection")
    radius, *others = {_number(path, view, _RADIUS, _number(path, root, _RADIUS, 0.0)) for view in views}
    if others:
        raise InputError(f"{path}: {_RADIUS} must be the same in all views")
    common = {name: _number(path, root, name, 0.0) for name in _NAMES}
    numbers = {name: np.array([_number(path, view, name, common[name]) for view in views]) for name in _NAMES}
    rtk = RtkGeometry(**numbers, RadiusCylindricalDetector=radius)
    _check_matrices(path, views, rtk)
    try:
        return from_rtk(rtk, panel)
    except Error as error:
        raise InputError(f"{path}: {error}") from None


def _number(path: Path, part: ElementTree.Element, name: str, otherwise: float) -> float:
    """Content of an element; the other value where there is none."""
    text = part.findtext(name)
    if text is None:
        return otherwise
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise InputError(f"{path}: {name} must be a number, got {text.strip()!r}")
    return value


def _check_matrices(path: Path, views: list[ElementTree.Element], rtk: RtkGeometry) -> None:
    """Refuse files whose matrices were changed and the numbers were not, or the other way round."""
    for number, (view, wanted) in enumerate(zip(views, rtk_matrices(rtk), strict=True)):
        text = view.findtext("Matrix")
        if text is None:
            continue
        try:
            found = np.array(text.split(), dtype=np.float64).reshape(3, 4)
        except ValueError:
            raise InputError(f"{path}: Matrix of view {number} must have 3 x 4 numbers") from None
        if np.abs(found - wanted).max() > _SAME * np.abs(wanted).max():
            raise InputError(f"{path}: Matrix of view {number} is not the one that its angles and distances give")
