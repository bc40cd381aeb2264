"""Gaussians as ellipsoids: those of the largest mass, in the colours of their bases."""

from dataclasses import dataclass

import numpy as np
import pyvista
import torch
from jaxtyping import Float, Integer

from recon.figures.basis_colours import brightest, mixed_colours
from recon.gaussians.model import Gaussians
from recon.ops.rasterize.reference import rotation

MOST, MOST_IN_A_PAGE = 20_000, 10_000  # ellipsoids; largest number in a window and in a page, for speed and size
FINE, COARSE = 1, 0  # divisions of the triangles of an icosahedron: 80 or 20 triangles per ellipsoid


@dataclass(frozen=True, eq=False)
class Ellipsoids:
    """Surfaces at one standard deviation from the centres.

    Parameters
    ----------
    mesh : triangles, with ``colour`` at their corners
    count : number of ellipsoids
    share : part of the mass of the Gaussians beyond the plane that the ellipsoids have, 0 to 1
    """

    mesh: pyvista.PolyData
    count: int
    share: float


def ellipsoids(gaussians: Gaussians, from_y: float, most: int = MOST, fineness: int = FINE) -> Ellipsoids:
    """Create ellipsoids of the Gaussians on one side of a plane, so that the inside is visible.

    Parameters
    ----------
    gaussians : model
    from_y : least y of a centre [mm]
    most : largest number of ellipsoids
    fineness : how often the triangles of an icosahedron are divided

    Returns
    -------
    ellipsoids of the largest masses, see `masses`
    """
    coefficients = _numbers(gaussians.coefficients)
    beyond = _numbers(gaussians.centres)[:, 1] >= from_y
    mass = masses(gaussians) * beyond
    chosen = np.sort(np.argsort(-mass, kind="stable")[: min(most, int(beyond.sum()))])
    chosen = chosen[mass[chosen] > 0]
    colours = np.rint(255 * mixed_colours(coefficients, gaussians.basis_names)[chosen]).astype(np.uint8)
    mesh = ellipsoid_mesh(*_shapes(gaussians, chosen), colours, fineness)
    share = float(mass[chosen].sum() / mass.sum()) if len(chosen) else 0.0
    return Ellipsoids(mesh, len(chosen), share)


def masses(gaussians: Gaussians) -> Float[np.ndarray, " gaussian"]:
    """Compute the integral of each Gaussian over space, summed over bases relative to their largest coefficients.

    Parameters
    ----------
    gaussians : model

    Returns
    -------
    masses [mm^3]
    """
    coefficients = _numbers(gaussians.coefficients)
    volume = (2 * np.pi) ** 1.5 * np.exp(_numbers(gaussians.log_scales).sum(axis=1))
    return volume * (coefficients / brightest(coefficients)).sum(axis=1)


def ellipsoid_mesh(
    centres: Float[np.ndarray, "gaussian 3"],
    scales: Float[np.ndarray, "gaussian 3"],
    rotations: Float[np.ndarray, "gaussian 3 3"],
    colours: Integer[np.ndarray, "gaussian 3"],
    fineness: int = FINE,
) -> pyvista.PolyData:
    """Create one mesh of all ellipsoids p + R S u, where u is the unit sphere; normals are R S^-1 u.

    Parameters
    ----------
    centres : centres p (x, y, z) [mm]
    scales : semi-axes S [mm]
    rotations : rotations R
    colours : red, green and blue, 0 to 255
    fineness : how often the triangles of an icosahedron are divided

    Returns
    -------
    mesh, with ``colour`` at its corners
    """
    ball = pyvista.Icosphere(nsub=fineness)
    unit = np.asarray(ball.points, dtype=np.float64)
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    corners = ball.faces.reshape(-1, 4)[:, 1:]
    points = np.einsum("nij,nj,kj->nki", rotations, scales, unit) + centres[:, None]
    normals = np.einsum("nij,nj,kj->nki", rotations, 1 / scales, unit)
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    triangles = (corners + len(unit) * np.arange(len(centres))[:, None, None]).reshape(-1, 3)
    mesh = pyvista.PolyData()
    if len(centres):
        mesh = pyvista.PolyData.from_regular_faces(points.reshape(-1, 3).astype(np.float32), triangles)
        mesh.point_data["colour"] = np.repeat(colours, len(unit), axis=0)
        mesh.point_data["Normals"] = normals.reshape(-1, 3).astype(np.float32)
        mesh.point_data.active_normals_name = "Normals"
    return mesh


def _shapes(gaussians: Gaussians, chosen: Integer[np.ndarray, " some"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centres, standard deviations and rotations of some Gaussians."""
    rotations = rotation(gaussians.quaternions[chosen].detach().cpu().double()).numpy()
    return _numbers(gaussians.centres)[chosen], np.exp(_numbers(gaussians.log_scales)[chosen]), rotations


def _numbers(tensor: torch.Tensor) -> np.ndarray:
    """Tensor as an array in float64."""
    return tensor.detach().cpu().double().numpy()
