"""Windows of the panel on which settings are tried."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8

from phantomgen.ops.expected_counts import CROSSED, EMPTY, ExpectedCounts, expected_counts
from phantomgen.scene.scan import Scan
from phantomgen.simulation.checks.reference_rays import worst_error
from phantomgen.simulation.forward_model.discretization import Settings
from phantomgen.simulation.forward_model.expected_counts import spectrum_of
from spectra.transmission import Transmission

# Views that settings are tried on.
VIEWS = 3
# Edge of a window [pixel].
_WINDOW = 48
# Most windows of a view.
_MOST_WINDOWS = 4
# Crossed pixels per view, and pixels per view and kind that are compared with a grid of rays.
_MOST_CROSSED = 800
Image = Float[np.ndarray, "channel row column"]
Frame = Float[np.ndarray, "4 3"]


@dataclass(frozen=True, eq=False)
class Window:
    """A part of a view, as a panel of its own.

    Parameters
    ----------
    view : number of the view in the scan with a flat panel
    frame : of the part
    size : rows and columns
    classes : of the pixels
    profile : lengths in the beam's profile, or None
    """

    view: int
    frame: Frame
    size: tuple[int, int]
    classes: UInt8[np.ndarray, "row column"]
    profile: Float[np.ndarray, "part rows columns"] | None


def windows_of(scan: Scan, transmission: Transmission, rng: np.random.Generator) -> tuple[Window, ...]:
    """Select parts of some views that contain edges.

    Parameters
    ----------
    scan : what is simulated
    transmission : path lengths to counts
    rng : source of random numbers

    Returns
    -------
    the windows
    """
    views = np.unique(np.linspace(0, len(scan.geometry) - 1, VIEWS).round().astype(int))
    flat, modules = scan.by_module, scan.geometry.panel.modules
    return tuple(w for view in views for w in _module_windows(flat, transmission, int(view), modules, rng))


def _module_windows(
    scan: Scan, transmission: Transmission, view: int, modules: int, rng: np.random.Generator
) -> list[Window]:
    """Windows of some modules of a view; of those with edges, where there are any."""
    if modules == 1:
        return list(_windows(scan, transmission, view, rng))
    with_edges, without = [], []
    for number in view * modules + rng.permutation(modules):
        for window in _windows(scan, transmission, int(number), rng):
            (with_edges if (window.classes >= CROSSED).any() else without).append(window)
        if len(with_edges) >= _MOST_WINDOWS:
            break
    return with_edges or without[:_MOST_WINDOWS]


def _windows(scan: Scan, transmission: Transmission, view: int, rng: np.random.Generator) -> Iterator[Window]:
    """Parts of a view around random edges; fewer where they hold many."""
    classes = exposed(scan, transmission, whole(scan, view), Settings(sub_rays=2)).classes
    edges = np.argwhere(classes >= CROSSED)
    if not len(edges):
        edges = np.argwhere(classes > EMPTY)
    if not len(edges):
        return
    crossed, corners = 0, set()
    for row, column in edges[rng.integers(len(edges), size=_MOST_WINDOWS)].tolist():
        if (corner := _corner(scan, row, column)) in corners:
            continue
        corners.add(corner)
        window = around(scan, view, classes, row, column)
        yield window
        crossed += int((window.classes == CROSSED).sum())
        if crossed > _MOST_CROSSED:
            return


def exposed(scan: Scan, transmission: Transmission, window: Window, settings: Settings) -> ExpectedCounts:
    """Compute the counts of a window.

    Parameters
    ----------
    scan : what is simulated
    transmission : path lengths to counts
    window : part of a view
    settings : how finely it is computed

    Returns
    -------
    counts and numbers of rays
    """
    scan = scan.by_module.instant(window.view)
    spectrum = spectrum_of(scan, transmission)._replace(profile=window.profile)
    scene, sampling = scan.scene, settings.sampling(scan.aperture)
    return expected_counts(window.frame, *window.size, scene.solids, spectrum, scene.background, sampling)


def worst_difference(images: Sequence[Image], exact: Sequence[Image]) -> float:
    """Compute the worst difference of log counts over whole windows.

    Parameters
    ----------
    images : counts of each window, (channel, row, column)
    exact : reference counts of each window

    Returns
    -------
    largest absolute difference
    """
    pairs = zip(images, exact, strict=True)
    return max((worst_error(a, b, b.max(axis=(1, 2), keepdims=True)) for a, b in pairs), default=0.0)


Counts = Float[np.ndarray, "..."]


def whole(scan: Scan, view: int) -> Window:
    """Return a whole view as a window; the classes of its pixels are unknown.

    Parameters
    ----------
    scan : what is simulated, with a flat panel
    view : number of the view

    Returns
    -------
    the window
    """
    panel = scan.geometry.panel
    size = (panel.rows, panel.columns)
    frame, unknown = scan.geometry.ray_frames()[view], np.empty((0, 0), np.uint8)
    return Window(view, frame, size, unknown, scan.view_profile(view))


def around(scan: Scan, view: int, classes: UInt8[np.ndarray, "row column"], row: int, column: int) -> Window:
    """Return the part of a view around a pixel.

    Parameters
    ----------
    scan : what is simulated, with a flat panel
    view : number of the view
    classes : classes of the pixels of the whole view
    row, column : the pixel

    Returns
    -------
    the window
    """
    panel = scan.geometry.panel
    top, left = _corner(scan, row, column)
    size = (min(_WINDOW, panel.rows), min(_WINDOW, panel.columns))
    part = (slice(top, top + size[0]), slice(left, left + size[1]))
    frame = scan.geometry.ray_frames()[view].copy()
    frame[1] += left * frame[2] + top * frame[3]
    lengths = scan.view_profile(view)
    profile = None if lengths is None else np.ascontiguousarray(lengths[:, *part])
    return Window(view, frame, size, classes[part], profile)


def _corner(scan: Scan, row: int, column: int) -> tuple[int, int]:
    """First row and column of the window around a pixel."""
    panel = scan.geometry.panel
    rows, columns = min(_WINDOW, panel.rows), min(_WINDOW, panel.columns)
    top, left = (
        np.clip(row - rows // 2, 0, panel.rows - rows),
        np.clip(column - columns // 2, 0, panel.columns - columns),
    )
    return int(top), int(left)
