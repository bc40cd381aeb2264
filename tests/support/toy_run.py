"""A toy run to look at: a cylinder's worth of boxes, a result that errs in known places, and a few Gaussians."""

import numpy as np
import torch

from phantomgen.dataset.truth import Truth
from phantomgen.geometry.voxel_grid import Grid
from recon.gaussians.model import Gaussians
from recon.output.viewer.content import RunContent

GRID = Grid.cube(16, 32.0)  # voxels of 2 mm
NAMES = ("photoelectric", "compton", "kedge_63.3")
COEFFICIENTS = np.array([[0.002, 0.02, 0.0], [0.018, 0.03, 0.0], [0.006, 0.02, 0.024]])


def boxes(grid=GRID):
    """Tissue that holds bone at low x and contrast at high x."""
    filled = np.zeros((3, 16, 16, 16), np.float32)
    filled[0, 2:14, 2:14, 2:14] = 1
    filled[1, 4:12, 6:10, 3:6] = 1
    filled[2, 4:12, 6:10, 10:13] = 1
    filled[0] -= filled[1] + filled[2]
    return Truth.of(grid, NAMES, ("tissue", "bone", "contrast"), COEFFICIENTS, filled, "")


def gaussians():
    """Two before the plane y = 0, three beyond it, one of these without any coefficient."""
    centres = torch.tensor([[5.0, -6, 0], [-5, -6, 0], [5, 6, 8], [-5, 6, 0], [0, 6, -5.0]])
    scales = torch.tensor([[2.0, 2, 2], [1, 1, 1], [3, 1, 1], [1, 1, 1], [1, 1, 1]]).log()
    turns = torch.tensor([[1.0, 0, 0, 0]]).repeat(5, 1)
    turns[2] = torch.tensor([2.0, 0, 0, 2.0])  # a quarter turn about z, not normalised
    coefficients = torch.tensor([[0, 0.02, 0], [0, 0.02, 0], [0, 0.02, 0.02], [0.01, 0.02, 0], [0, 0, 0]])
    return Gaussians(centres, scales, turns, coefficients, NAMES)


def content(truth=True, model=True, names=NAMES):
    known = boxes()
    result = known.volumes.copy()
    result[2, 4:12, 6:10, 10:13] *= 0.5  # half the contrast
    taken = [NAMES.index(name) for name in names]
    return RunContent.of("toy", GRID, names, result[taken], known if truth else None, gaussians() if model else None)


def pixel_of(pane, point):
    """Row and column of a point (x, y, z) in a picture of the window, by the formula of a parallel projection."""
    focus, eye = np.array(pane.camera.focal_point), np.array(pane.camera.position)
    toward = (eye - focus) / np.linalg.norm(eye - focus)
    right = np.cross([0.0, 0.0, 1.0], toward)
    right /= np.linalg.norm(right)
    width, height = pane.size
    x0, _, _, y1 = pane.viewport
    window = pane.plotter.window_size
    zoom = height / 2 / pane.camera.parallel_scale
    across, up = (float(np.dot(axis, point - focus)) * zoom for axis in (right, np.cross(toward, right)))
    return round((1 - y1) * window[1] + height / 2 - up), round(x0 * window[0] + width / 2 + across)
