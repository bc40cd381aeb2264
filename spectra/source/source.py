"""X-ray sources: photons per keV between lines, and the lines apart.

Bremsstrahlung is a piecewise-linear density, so that its integral and mean over any bin are exact; characteristic lines
are single energies. Quadrature needs the two apart: a line inside a wide bin is most of what goes wrong in
polychromatic models.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from math import ceil

import numpy as np
from jaxtyping import Float

from spectra.energy.grid import Energies, EnergyArray
from spectra.errors import InputError
from spectra.materials.material import Material

# Below this part of the photons a filter leaves nothing that data can be scaled to.
_LEAST_TRANSMISSION = 1e-12
# Corners of a density are at most this far apart [keV], so that it stays exact to 1e-3 behind filters.
_FINE = 0.1
# A Gaussian band ends so many full widths at half maximum from its centre: 2.5e-6 of it lie beyond.
_BAND_END = 2.0
# Corners of the density of a Gaussian band: 100 per full width at half maximum.
_BAND_CORNERS = 401


@dataclass(frozen=True)
class Filter:
    """Flat filter.

    Parameters
    ----------
    material : of the filter
    thickness : of the filter [mm]
    """

    material: Material
    thickness: float

    def __post_init__(self) -> None:
        if not 0 <= self.thickness < np.inf:
            raise InputError(
                f"the thickness of the {self.material.name} filter must be finite and not negative, "
                f"got {self.thickness:g} mm"
            )

    def transmission(self, energy: EnergyArray) -> EnergyArray:
        """Compute the fraction of the photons that passes at normal incidence.

        Parameters
        ----------
        energy : photon energies [keV]

        Returns
        -------
        fraction of each energy
        """
        return np.exp(-self.thickness * self.material.attenuation(energy))


@dataclass(frozen=True, eq=False)
class Source:
    """Source spectrum: photons that reach one pixel in one view at the panel centre without an object.

    Parameters
    ----------
    energy, density : corners of the piecewise-linear density, [keV] and [photons/keV]; equal energies make a jump
    line_energy, line_photons : characteristic lines, [keV] and [photons]
    maximum : highest energy, the tube voltage of a tube [keV]
    breaks : energies where the density jumps [keV]
    """

    energy: Float[np.ndarray, " corner"]
    density: Float[np.ndarray, " corner"]
    line_energy: Float[np.ndarray, " line"]
    line_photons: Float[np.ndarray, " line"]
    maximum: float
    breaks: tuple[float, ...] = field(default=())

    @classmethod
    def tube(
        cls,
        kvp: float,
        photons: float | None,
        angle: float = 12.0,
        filters: Sequence[Filter] = (),
        anode: str = "tungsten",
    ) -> "Source":
        """Create the spectrum of a reflection tube by SpekPy's model `casim`.

        Parameters
        ----------
        kvp : tube voltage [kV]
        photons : incident photons per pixel and view behind all filters; None for those per cm^2 and mAs at 1 m, a
            number that only the model vouches for
        angle : anode angle [degree]
        filters : all filtration, inherent filtration included: the model itself has none
        anode : ``tungsten``, or ``molybdenum``, ``rhodium``, ``silver`` up to 50 kV

        Returns
        -------
        the source
        """
        from spectra.source.tube import unfiltered_tube  # noqa: PLC0415 - SpekPy takes a second to import

        tube = unfiltered_tube(kvp, angle, anode).behind(filters)
        return tube if photons is None else tube.scaled(photons)

    @classmethod
    def monochromatic(cls, energy: float, photons: float) -> "Source":
        """Create a source with all photons at one energy.

        Parameters
        ----------
        energy : the energy [keV]
        photons : number of photons

        Returns
        -------
        the source

        Raises
        ------
        InputError
            When the energy is outside 1 .. 800 keV.
        """
        if not 1 <= energy <= 800:
            raise InputError(f"the energy of a monochromatic source must lie in 1 .. 800 keV, got {energy:g}")
        none = np.empty(0)
        return cls(none, none, np.array([float(energy)]), np.ones(1), float(energy)).scaled(photons)

    @classmethod
    def of_lines(cls, lines: Mapping[float, float], photons: float | None = None) -> "Source":
        """Create a source of several single energies, such as those of a radionuclide.

        Parameters
        ----------
        lines : energy [keV] to photons, or to relative weights where `photons` is given
        photons : of all lines together; None where `lines` has them

        Returns
        -------
        the source

        Raises
        ------
        InputError
            When there is no line, or one has no positive weight or lies outside 1 .. 800 keV.
        """
        if not lines:
            raise InputError("a source of lines needs at least one line")
        for energy, weight in lines.items():
            if not (1 <= energy <= 800 and 0 < weight < np.inf):
                raise InputError(
                    f"a line needs an energy within 1 .. 800 keV and a positive weight, got {energy:g}: {weight:g}"
                )
        energy, weight = np.array(sorted(lines.items()), dtype=np.float64).T.copy()
        none = np.empty(0)
        source = cls(none, none, energy, weight, float(energy[-1]))
        return source if photons is None else source.scaled(photons)

    @classmethod
    def band(cls, energy: float, width: float, photons: float, shape: str = "gaussian") -> "Source":
        """Create a source with one band of energies, such as a monochromator transmits.

        Parameters
        ----------
        energy : centre E0 [keV]
        width : full width at half maximum w [keV]
        photons : in the whole band
        shape : ``gaussian``, density ~ exp(-4 ln 2 (E - E0)^2 / w^2), cut off at E0 +- 2 w; or ``box``, constant within
            E0 +- w / 2

        Returns
        -------
        the source

        Raises
        ------
        InputError
            When the shape is unknown, or the band does not lie within 1 .. 800 keV.
        """
        if shape not in {"gaussian", "box"}:
            raise InputError(f"the shape of a band is gaussian or box, got {shape!r}")
        half = width * (_BAND_END if shape == "gaussian" else 0.5)
        if not (width > 0 and energy - half >= 1 and energy + half <= 800):
            raise InputError(
                f"a band must have a positive width and lie within 1 .. 800 keV, got {energy:g} keV and a width of "
                f"{width:g} keV"
            )
        if shape == "box":
            return cls.of_bins(np.array([energy - half, energy + half]), np.ones(1)).scaled(photons)
        x = np.linspace(-half, half, _BAND_CORNERS)
        none, density = np.empty(0), np.exp(-4 * np.log(2) * (x / width) ** 2)
        return cls(energy + x, density, none, none, float(energy + half)).scaled(photons)

    @classmethod
    def of_bins(cls, edges: Float[np.ndarray, " energy_plus_1"], photons: EnergyArray) -> "Source":
        """Create a source from a histogram; the density in each bin is constant.

        Lines inside a bin cannot be separated from the rest.

        Parameters
        ----------
        edges : contiguous bin edges, ascending [keV]
        photons : in each bin

        Returns
        -------
        the source

        Raises
        ------
        InputError
            When photons are negative or not finite, or lie outside 1 .. 800 keV.
        """
        edges, photons = Energies.from_edges(edges).edges, np.asarray(photons, dtype=np.float64)
        if photons.shape != (len(edges) - 1,):
            raise InputError(f"{len(edges) - 1} energy bins need as many numbers of photons, got {photons.shape}")
        if not (np.isfinite(photons).all() and photons.min() >= 0 and photons.sum() > 0):
            raise InputError("photons per bin must be finite and not negative, and some positive")
        seen = np.flatnonzero(photons)
        edges, photons = edges[seen[0] : seen[-1] + 2], photons[seen[0] : seen[-1] + 1]
        if not (edges[0] >= 1 and edges[-1] <= 800):
            raise InputError(f"photons must lie within 1 .. 800 keV, got {edges[0]:g} .. {edges[-1]:g}")
        parts = [np.linspace(a, b, 1 + ceil((b - a) / _FINE)) for a, b in pairwise(edges)]
        density = [np.full(len(x), n / (x[-1] - x[0])) for x, n in zip(parts, photons, strict=True)]
        none = np.empty(0)
        return cls(np.concatenate(parts), np.concatenate(density), none, none, float(edges[-1]))

    @classmethod
    def of_corners(
        cls, energy: EnergyArray, density: EnergyArray, lines: Mapping[float, float], breaks: tuple[float, ...] = ()
    ) -> "Source":
        """Create a source from a density that is linear between corners, and lines.

        Parameters
        ----------
        energy, density : corners, ascending [keV] and [photons/keV]; two of the same energy make a jump
        lines : energy [keV] to photons
        breaks : energies that grids of bins are to keep, such as the K edges of filters [keV]

        Returns
        -------
        the source

        Raises
        ------
        InputError
            When there are no photons, or some lie outside 1 .. 800 keV.
        """
        at, photons = np.array(sorted(lines.items()), dtype=np.float64).reshape(-1, 2).T.copy()
        used = np.concatenate([energy, at])
        if len(energy) == 1 or not len(used) or used.min() < 1 or used.max() > 800:
            raise InputError(
                f"a spectrum needs two corners of its density at least, or lines, within 1 .. 800 keV, got "
                f"{len(energy)} and {len(at)}" + (f" within {used.min():g} .. {used.max():g}" if len(used) else "")
            )
        source = cls(np.asarray(energy, np.float64), np.asarray(density, np.float64), at, photons, float(used.max()))
        if not source.photons > 0:
            raise InputError("a spectrum needs photons: all values are 0")
        return replace(source, breaks=tuple(sorted(breaks)))

    def __repr__(self) -> str:
        kind = f"{self.line_energy[0]:g} keV" if self.is_monochromatic else f"up to {self.maximum:g} keV"
        return f"Source({kind}, {self.photons:g} photons)"

    @property
    def is_monochromatic(self) -> bool:
        """True when there is a single energy."""
        return len(self.energy) == 0 and len(self.line_energy) == 1

    @property
    def photons(self) -> float:
        """Number of all photons."""
        return float(self._cumulative(np.array([np.inf]))[0][0] + self.line_photons.sum())

    def density_at(self, energy: EnergyArray) -> EnergyArray:
        """Evaluate the density without the lines; at a jump, its upper side.

        Parameters
        ----------
        energy : energies [keV]

        Returns
        -------
        density [photons/keV]
        """
        return self._inside(np.asarray(energy, dtype=np.float64))[1]

    def photons_in(self, edges: Float[np.ndarray, " energy_plus_1"]) -> tuple[EnergyArray, EnergyArray]:
        """Compute the exact number of photons in contiguous bins, and their mean energies.

        A line on an edge belongs to the bin above it, or to the last bin. Bins without photons have their middle as
        mean energy.

        Parameters
        ----------
        edges : bin edges, ascending [keV]

        Returns
        -------
        photons, and mean energy [keV], of each bin
        """
        edges = np.asarray(edges, dtype=np.float64)
        photons, energy = (np.diff(integral) for integral in self._cumulative(edges))
        inside = (self.line_energy >= edges[0]) & (self.line_energy <= edges[-1])
        lines, counts = self.line_energy[inside], self.line_photons[inside]
        bins = np.minimum(np.searchsorted(edges, lines, side="right") - 1, len(edges) - 2)
        np.add.at(photons, bins, counts)
        np.add.at(energy, bins, counts * lines)
        photons = np.maximum(photons, 0.0)
        middle = (edges[:-1] + edges[1:]) / 2
        mean = np.where(photons > 0, energy / np.where(photons > 0, photons, 1.0), middle)
        return photons, np.clip(mean, edges[:-1], edges[1:])

    def sampled(self, energies: Energies) -> tuple[Energies, EnergyArray]:
        """Compute the photons per bin of a grid, and move its nodes to the mean energies.

        Gauss nodes do not move.

        Parameters
        ----------
        energies : energy bins

        Returns
        -------
        the grid with moved nodes, and the photons of each bin
        """
        if not energies.gauss:
            photons, mean = self.photons_in(energies.edges)
            return Energies(energies.edges, mean), photons
        lines = replace(self, energy=np.empty(0), density=np.empty(0)).photons_in(energies.edges)[0]
        return energies, self.density_at(energies.nodes) * energies.widths + lines

    def grid(self, low: float, count: int, breaks: Sequence[float] = ()) -> Energies:
        """Create a grid of about `count` bins up to the maximum, snapped to `breaks` and to those of the source.

        Every line has a bin of its own; a monochromatic source has one bin.

        Parameters
        ----------
        low : lower end of the grid [keV]
        count : approximate number of bins
        breaks : further energies that become edges [keV]

        Returns
        -------
        the grid
        """
        if self.is_monochromatic:
            return Energies.single(self.maximum)
        return Energies.snapped(low, self.maximum, count, (*breaks, *self.breaks), self.line_energy)

    def scaled(self, photons: float) -> "Source":
        """Scale the spectrum to another number of photons.

        Parameters
        ----------
        photons : number of all photons

        Returns
        -------
        source with the same shape of the spectrum

        Raises
        ------
        InputError
            When the number is not positive.
        """
        if not 0 < photons < np.inf:
            raise InputError(f"the number of photons must be positive, got {photons:g}")
        factor = photons / self.photons
        return replace(self, density=self.density * factor, line_photons=self.line_photons * factor)

    def behind(self, sheets: Sequence[Filter]) -> "Source":
        """Compute the spectrum behind a stack of flat filters.

        Parameters
        ----------
        sheets : the filters

        Returns
        -------
        source behind all of them
        """
        _check_stack(self, sheets)
        source = self
        for sheet in sheets:
            source = source.filtered(sheet)
        return source

    def filtered(self, sheet: Filter) -> "Source":
        """Compute the spectrum behind a flat filter, whose K edges become breaks.

        Parameters
        ----------
        sheet : the filter

        Returns
        -------
        source behind it

        Raises
        ------
        InputError
            When the filter absorbs all photons.
        """
        low = float(self.energy[0]) if len(self.energy) else 0.0
        edges = sheet.material.k_edges(low, self.maximum)
        split = self
        for edge in edges:
            split = split._with_jump(edge)
        first_of_pair = np.append(np.diff(split.energy) == 0, False)
        passed = sheet.transmission(np.where(first_of_pair, split.energy - 1e-9, split.energy))
        behind = replace(
            split,
            density=split.density * passed,
            line_photons=split.line_photons * sheet.transmission(split.line_energy),
            breaks=tuple(sorted({*self.breaks, *edges})),
        )
        if behind.photons < _LEAST_TRANSMISSION * self.photons:
            raise InputError(f"{sheet.thickness:g} mm of {sheet.material.name} absorb all photons of the source")
        return behind

    def _with_jump(self, edge: float) -> "Source":
        """Insert two corners of equal energy, where a filter's edge will make the density jump."""
        if len(self.energy) == 0 or (self.energy == edge).sum() >= 2:
            return self
        kept = self.energy != edge
        at = np.searchsorted(self.energy[kept], edge)
        value = np.interp(edge, self.energy, self.density)
        return replace(
            self,
            energy=np.insert(self.energy[kept], at, [edge, edge]),
            density=np.insert(self.density[kept], at, [value, value]),
        )

    def _inside(self, energy: EnergyArray) -> tuple[np.ndarray, EnergyArray, EnergyArray]:
        """Segment, density and slope at each energy; density 0 outside the corners."""
        if len(self.energy) < 2:
            return np.zeros(len(energy), dtype=np.int64), np.zeros_like(energy), np.zeros_like(energy)
        width = np.diff(self.energy)
        slopes = np.where(width > 0, np.diff(self.density) / np.where(width > 0, width, 1.0), 0.0)
        segment = np.clip(np.searchsorted(self.energy, energy, side="right") - 1, 0, len(self.energy) - 2)
        slope = slopes[segment]
        value = self.density[segment] + slope * (energy - self.energy[segment])
        inside = (energy >= self.energy[0]) & (energy <= self.energy[-1])
        return segment, np.where(inside, value, 0.0), slope

    def _cumulative(self, energy: EnergyArray) -> tuple[EnergyArray, EnergyArray]:
        """Photons below each energy, and their summed energy [keV], both without lines."""
        if len(self.energy) < 2:
            return np.zeros_like(energy), np.zeros_like(energy)
        x, y = self.energy, self.density
        width, rise = np.diff(x), np.diff(y)
        counts = np.append(0.0, np.cumsum(width * (y[:-1] + rise / 2)))
        energies = np.append(0.0, np.cumsum(width * (x[:-1] * (y[:-1] + rise / 2) + width * (y[:-1] / 2 + rise / 3))))
        end = np.clip(energy, x[0], x[-1])
        segment, _, slope = self._inside(end)
        t = end - x[segment]
        area = t * (y[segment] + slope * t / 2)
        return counts[segment] + area, energies[segment] + x[segment] * area + t**2 * (y[segment] / 2 + slope * t / 3)


def _check_stack(source: Source, sheets: Sequence[Filter]) -> None:
    """Refuse filters that together leave nothing at any energy, also where each of them alone leaves a little."""
    energy = np.append(source.energy, source.line_energy)
    passed = np.prod([sheet.transmission(energy) for sheet in sheets], axis=0)
    if np.max(passed) < _LEAST_TRANSMISSION:
        names = dict.fromkeys(sheet.material.name for sheet in sheets)
        total = {name: sum(s.thickness for s in sheets if s.material.name == name) for name in names}
        stack = " and ".join(f"{thickness:g} mm of {name}" for name, thickness in total.items())
        raise InputError(f"{stack} absorb all photons of the source")
