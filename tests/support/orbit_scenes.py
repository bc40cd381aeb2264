"""Orbits of every kind around one small scene of Gaussians, whose line integrals are exact."""

import numpy as np
import torch

from phantomgen.geometry.orbits import helical, laminography, parallel, short_arc, spread_angles
from phantomgen.geometry.panel import Panel
from phantomgen.geometry.panel_mount import Mount, mounted
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from recon.gaussians.model import Gaussians

GRID = Grid.cube(24, 24.0)
PANEL, NARROW = Panel(40, 48, 1.6), Panel(40, 32, 1.6)  # the narrow one sees 60 % of the field if it is shifted
SOD, SDD = 60.0, 96.0
FAN = float(np.arctan(PANEL.columns * PANEL.column_pitch / 2 / SDD))


def circle(views=96, arc=360.0, start=33.0, panel=PANEL):
    return Geometry.circular(SOD, SDD, spread_angles(views, 0, arc, start), panel)


def short(views=72, start=33.0):
    return circle(views, short_arc(FAN), start)


FILTERED = {  # orbits of filtered back-projection
    "full circle": circle(),
    "half-fan": mounted(circle(panel=NARROW), Mount((14.0, 0.0))),
    "half-fan, other side": mounted(circle(panel=NARROW), Mount((-14.0, 0.0))),
    "short scan": short(),
    "short scan, clockwise": short()[::-1],
    "long arc": circle(84, 300.0),
    "tilted panel": mounted(circle(), Mount(tilt=(0.1, 0.2, 0.3))),
    "panel on its side": mounted(circle(panel=Panel(48, 48, 1.6)), Mount(tilt=(0.0, 0.0, np.pi / 2))),
    "half a turn, parallel": parallel(300, spread_angles(48, 0, 180.0), Panel(40, 48, 1.0)),
    "half-fan, parallel": mounted(parallel(300, spread_angles(96, 0), Panel(40, 32, 1.0)), Mount((9.0, 0.0))),
}
ITERATED = {  # orbits for iterations
    "helix": helical(SOD, SDD, 2 * spread_angles(60, 0), 12.0, PANEL),
    "laminography": laminography(SOD, SDD, spread_angles(60, 0), 0.5, PANEL),
    "limited arc": circle(40, 140.0),
    "uneven views": circle(60)[np.r_[0:30, 32:60:4]],
    "off-centre short scan": mounted(short(), Mount((6.0, 0.0))),
    "panel beside the axis": mounted(circle(60, panel=NARROW), Mount((26.0, 0.0))),
    "tilted parallel beam": parallel(300, spread_angles(60, 0), Panel(40, 48, 1.0), 0.4),
}


def blobs(centres=((0.0, 0.0, 0.0), (6.0, -3.0, 0.0)), sigma=2.5):
    """Upright Gaussians of two bases, the second twice the first [1/mm]."""
    count = len(centres)
    turns, values = torch.tensor([[1.0, 0, 0, 0]]), torch.tensor([[0.01, 0.02]])
    return Gaussians(
        torch.tensor(centres), torch.full((count, 3), float(np.log(sigma))), turns.repeat(count, 1),
        values.repeat(count, 1), ("photoelectric", "compton"),
    )  # fmt: skip


def relative_error(volumes, truth):
    """Root mean square error over the largest true value."""
    return float(np.sqrt(np.mean((volumes - truth) ** 2)) / truth.max())
