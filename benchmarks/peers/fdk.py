"""Filtered back-projection beside RTK's, on perfect data: the exact line integrals of ellipsoids.

Needs the package itk-rtk. Prints one row per orbit: PSNR against the truth, with the maximum of the truth as its peak,
of both, and how far the two volumes are apart. Run: python -m benchmarks.peers.fdk
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from phantomgen.geometry.conversions.rtk import to_rtk_object
from phantomgen.geometry.orbits import short_arc, spread_angles
from phantomgen.geometry.panel import Panel
from phantomgen.geometry.panel_mount import Mount, mounted
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from recon.voxel.filtered.fdk import fdk

SOD, SDD, VIEWS = 500.0, 800.0, 180
GRID = Grid.cube(48, 96.0)
PANEL, NARROW = Panel(96, 96, 2.0), Panel(96, 64, 2.0)
BODIES = (  # centre, radii [mm], value [1/mm]
    ((0.0, 0.0, 0.0), (40.0, 34.0, 36.0), 0.02),
    ((-14.0, 6.0, 4.0), (9.0, 9.0, 9.0), 0.015),
    ((15.0, -8.0, -3.0), (7.0, 11.0, 9.0), -0.01),
)
FAN = float(np.arctan(PANEL.columns * PANEL.column_pitch / 2 / SDD))
ORBITS = {
    "full circle": Geometry.circular(SOD, SDD, spread_angles(VIEWS, 0), PANEL),
    "half-fan": mounted(Geometry.circular(SOD, SDD, spread_angles(VIEWS, 0), NARROW), Mount((30.0, 0.0))),
    "short scan": Geometry.circular(SOD, SDD, spread_angles(110, 0, short_arc(FAN)), PANEL),
}
Volume = np.ndarray


def line_integrals(geometry: Geometry) -> np.ndarray:
    """Sum over the ellipsoids of value times chord, (view, row, column)."""
    rows, columns = np.meshgrid(np.arange(geometry.panel.rows), np.arange(geometry.panel.columns), indexing="ij")
    out = np.zeros((len(geometry), *rows.shape))
    for view, (source, first, column, row) in enumerate(geometry.ray_frames()):
        rays = first + columns[..., None] * column + rows[..., None] * row
        length = np.linalg.norm(rays, axis=-1)
        for centre, radii, value in BODIES:
            o, d = (source - np.array(centre)) / radii, rays / radii
            a, b, c = (d * d).sum(-1), (d * o).sum(-1), (o * o).sum() - 1
            out[view] += value * 2 * np.sqrt(np.maximum(b * b - a * c, 0)) / a * length
    return out.astype(np.float32)


def truth() -> Volume:
    """Means over 4^3 points per voxel."""
    n = 4
    offsets = (np.arange(n) + 0.5) / n - 0.5
    x, y, z = ((GRID.axis(name)[:, None] + offsets * GRID.spacing["zyx".index(name)]).ravel() for name in "xyz")
    fine = np.zeros((len(z), len(y), len(x)), np.float32)
    for (cx, cy, cz), (rx, ry, rz), value in BODIES:
        inside = ((z - cz) / rz)[:, None, None] ** 2 + ((y - cy) / ry)[:, None] ** 2 + ((x - cx) / rx) ** 2 < 1
        fine += np.float32(value) * inside
    depth, height, width = GRID.shape
    return fine.reshape(depth, n, height, n, width, n).mean(axis=(1, 3, 5))


def rtk_fdk(images: np.ndarray, geometry: Geometry, short: bool, half: bool) -> Volume:
    """RTK's volume on the same grid; our (x, y, z) are its (z, x, y)."""
    import itk  # noqa: PLC0415

    rtk = itk.RTK
    kind = itk.Image[itk.F, 3]
    poses = to_rtk_object(geometry)
    stack = itk.image_from_array(np.ascontiguousarray(images[:, ::-1]))  # rows go up
    panel = geometry.panel
    stack.SetSpacing([panel.column_pitch, panel.row_pitch, 1.0])
    stack.SetOrigin([-(panel.columns - 1) / 2 * panel.column_pitch, -(panel.rows - 1) / 2 * panel.row_pitch, 0.0])
    last: Any = stack
    if half:
        shifted = rtk.DisplacedDetectorImageFilter[kind].New(Input=last, Geometry=poses)
        shifted.Update()
        last = shifted.GetOutput()
    if short:
        parker = rtk.ParkerShortScanImageFilter[kind].New(Input=last, Geometry=poses)
        parker.Update()
        last = parker.GetOutput()
    spacing = GRID.spacing[0]
    empty = rtk.ConstantImageSource[kind].New(
        Origin=[GRID.origin[0]] * 3, Spacing=[spacing] * 3, Size=list(GRID.shape), Constant=0.0
    )
    empty.Update()
    filtered = rtk.FDKConeBeamReconstructionFilter[kind].New(Geometry=poses)
    filtered.SetInput(0, empty.GetOutput())
    filtered.SetInput(1, last)
    filtered.GetRampFilter().SetTruncationCorrection(0.0)
    filtered.GetRampFilter().SetHannCutFrequency(1.0)
    filtered.Update()
    volume = itk.array_from_image(filtered.GetOutput())  # indices (RTK z, y, x) = (our x, z, y)
    return np.ascontiguousarray(volume.transpose(1, 2, 0))


def psnr(volume: Volume, right: Volume) -> float:
    """10 log10(max^2 / MSE) of the middle half of the slices, where cone angles are small [dB]."""
    middle = slice(len(right) // 4, 3 * len(right) // 4)
    error = max(float(np.mean((volume[middle] - right[middle]) ** 2)), 1e-30)
    return float(10 * np.log10(right.max() ** 2 / error))


def compared(name: str, peer: Callable[..., Volume] = rtk_fdk) -> tuple[float, float, float]:
    """PSNR of ours, of the peer's, and of the one against the other [dB]."""
    geometry, right = ORBITS[name], truth()
    images = line_integrals(geometry)
    ours = fdk(images[:, None], geometry, GRID)[0]
    other = peer(images, geometry, name == "short scan", name == "half-fan")
    return psnr(ours, right), psnr(other, right), psnr(ours, other)


if __name__ == "__main__":
    print(f"{'orbit':<14}{'ours':>8}{'RTK':>8}{'apart':>8}   [dB]")
    for orbit in ORBITS:
        print(f"{orbit:<14}" + "".join(f"{value:8.2f}" for value in compared(orbit)))
