"""Volume fractions of materials that are named, voxel by voxel: a decomposition whose volumes add up to one.

M coefficients and the condition that fractions add up to one tell M + 1 materials apart, and a voxel of a real object
rarely holds more. So the materials are the corners of simplices, each of at most M + 1 corners, that fill their hull
without overlapping (a Delaunay triangulation); simplices of empty space and the faces of the hull in front of it fill
the rest. A voxel is decomposed into the corners of the simplex that holds its coefficients: empty space has a share
only where the materials alone cannot make them up. Outside of all simplices it is decomposed as the nearest place in
one. Two coefficients are as far apart as the attenuation they stand for, rms over the detected spectrum.

References
----------
.. [1] Mendonca, Lamb & Sahani 2014, doi:10.1109/TMI.2013.2281719: more materials than energies, one triplet per voxel
.. [2] Liu, Yu, Primak & McCollough 2009, doi:10.1118/1.3097632: three materials from two energies by their volumes
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain, combinations

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull, Delaunay, QhullError

from spectra.basis.basis import Basis
from spectra.errors import InputError
from spectra.materials.material import Material

_INSIDE = 1e-9  # a fraction may be so far below 0 by rounding
_APART = 1e-4  # least singular value of the places of materials over the largest; our choice


@dataclass(frozen=True, eq=False)
class Decomposition:
    """Simplices of materials in the space of coefficients.

    Parameters
    ----------
    names : of the materials
    metric : maps coefficients to places whose distances are rms differences of attenuation
    corners : places of the materials, and of empty space at last
    simplices : indices of the corners of each simplex
    """

    names: tuple[str, ...]
    metric: Float[np.ndarray, "place basis"]
    corners: Float[np.ndarray, "corner place"]
    simplices: tuple[tuple[int, ...], ...]

    @classmethod
    def of(
        cls,
        materials: Sequence[Material],
        basis: Basis,
        energy: Float[np.ndarray, " node"],
        weights: Float[np.ndarray, " node"],
    ) -> "Decomposition":
        """Create the decomposition into some materials.

        Parameters
        ----------
        materials : compositions with densities
        basis : basis functions of the coefficients
        energy, weights : detected spectrum, energies [keV] and photons

        Returns
        -------
        decomposition

        Raises
        ------
        InputError
            When there is no material, one is named twice, or the basis does not tell them apart.
        """
        names = tuple(material.name for material in materials)
        if not names or len(set(names)) < len(names):
            raise InputError(f"fractions are of one or more different materials, got {', '.join(names) or 'none'}")
        root = np.sqrt(weights / np.sum(weights))
        _, metric = np.linalg.qr((basis.evaluate(energy) * root).T)
        found = [material.coefficients_in(basis, energy, weights) for material in materials]
        corners = np.array([*found, np.zeros(len(basis))]) @ metric.T
        return cls(names, metric, corners, _simplices(names, corners))

    def fractions(self, values: Float[np.ndarray, "basis ..."]) -> Float[np.ndarray, "material ..."]:
        """Decompose coefficients.

        Parameters
        ----------
        values : coefficients [1/mm]

        Returns
        -------
        volume fractions, none negative; empty space has what is left to one
        """
        places = self.metric @ np.reshape(values, (len(values), -1)).astype(np.float64)
        found = np.zeros((len(self.corners), places.shape[1]))
        for simplex in self.simplices:
            shares = self._shares(simplex, places)
            held = (shares >= -_INSIDE).all(axis=0)
            if len(simplex) <= len(places):  # no volume: near it is not in it
                held &= self._distance(simplex, shares, places) <= _INSIDE * np.abs(self.corners).max()
            found[:, held] = 0.0
            found[np.array(simplex)[:, None], np.flatnonzero(held)] = shares[:, held]
        outside = ~found.any(axis=0)
        if outside.any():
            found[:, outside] = self._nearest(places[:, outside])
        return np.clip(found[:-1], 0.0, 1.0).reshape(-1, *np.shape(values)[1:])

    def _shares(self, corners: tuple[int, ...], places: Float[np.ndarray, "place n"]) -> Float[np.ndarray, "corner n"]:
        """Shares, which add up to one, of corners in the nearest point of the plane through them."""
        base, *others = self.corners[list(corners)]
        if not others:
            return np.ones((1, places.shape[1]))
        rest = np.linalg.pinv((np.array(others) - base).T) @ (places - base[:, None])
        return np.concatenate([1.0 - rest.sum(axis=0, keepdims=True), rest])

    def _distance(
        self, corners: tuple[int, ...], shares: Float[np.ndarray, "corner n"], places: Float[np.ndarray, "place n"]
    ) -> Float[np.ndarray, " n"]:
        """Distance of places from what shares of corners make up [1/mm]."""
        return np.linalg.norm(self.corners[list(corners)].T @ shares - places, axis=0)

    def _nearest(self, places: Float[np.ndarray, "place n"]) -> Float[np.ndarray, "corner n"]:
        """Shares of all corners in the nearest point of the hull, which lies on a face of some simplex."""
        found, nearest = np.zeros((len(self.corners), places.shape[1])), np.full(places.shape[1], np.inf)
        for face in _faces(self.simplices):
            shares = self._shares(face, places)
            distance = self._distance(face, shares, places)
            closer = (shares >= 0).all(axis=0) & (distance < nearest)
            nearest[closer] = distance[closer]
            found[:, closer] = 0.0
            found[np.array(face)[:, None], np.flatnonzero(closer)] = shares[:, closer]
        return found


def parse_material(text: str) -> Material:
    """Read a material as ``--material`` takes it.

    Parameters
    ----------
    text : a named material, an element or a formula; a density [g/cm^3] may follow a colon

    Returns
    -------
    material with the composition as its name

    Raises
    ------
    InputError
        When the composition is unknown, or the density is missing or no positive number.
    """
    name, colon, density = text.partition(":")
    name = name.strip()
    try:
        number = float(density) if colon else None
    except ValueError:
        raise InputError(
            f"--material takes a composition and a density in g/cm^3, such as hydroxyapatite:2.9, got {text!r}"
        ) from None
    return Material(name, number, name)


def named_materials(materials: Sequence[str | Material]) -> list[Material]:
    """Read the materials that are given as text, see `parse_material`.

    Parameters
    ----------
    materials : materials, or their texts

    Returns
    -------
    materials
    """
    return [parse_material(one) if isinstance(one, str) else one for one in materials]


def _simplices(names: tuple[str, ...], corners: Float[np.ndarray, "corner place"]) -> tuple[tuple[int, ...], ...]:
    """Simplices that fill the hull of the corners; one of all corners where there are too few to fill space."""
    count, axes = corners.shape
    scaled = corners / np.abs(corners).max()
    if count <= axes + 1:
        if np.sum(np.linalg.svd(scaled, compute_uv=False) > _APART) < count - 1:
            raise InputError(f"the basis does not tell {', '.join(names)} and empty space apart: name fewer materials")
        return (tuple(range(count)),)
    if axes == 1:
        order = np.argsort(scaled[:, 0])
        return tuple(zip(order[:-1].tolist(), order[1:].tolist(), strict=True))
    try:
        full, hull = Delaunay(scaled[:-1]).simplices, ConvexHull(scaled[:-1])
    except QhullError:
        raise InputError(f"the basis does not tell {', '.join(names)} apart: name fewer materials") from None
    seen = hull.simplices[hull.equations[:, -1] > 0]  # faces that empty space, at 0, lies in front of
    left = [name for i, name in enumerate(names) if i not in full]
    if left or not len(seen):
        raise InputError(
            f"the basis does not tell {', '.join(left) or 'empty space'} from mixtures of the other materials: name "
            "fewer of them"
        )
    return tuple(tuple(sorted(map(int, simplex))) for simplex in (*full, *([*face, count - 1] for face in seen)))


def _faces(simplices: tuple[tuple[int, ...], ...]) -> list[tuple[int, ...]]:
    """All points, edges and further faces of simplices, themselves included, each once, small ones first."""
    parts = (combinations(simplex, size) for simplex in simplices for size in range(1, len(simplex) + 1))
    return sorted(set(chain.from_iterable(parts)), key=lambda face: (len(face), face))
