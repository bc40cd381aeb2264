"""Small errors of a stated spectral model: voltage, filter and thresholds that differ from what a dataset states.

A dataset holds sensitivities of channels. They are changed as the parts of a scanner would change them:

- voltage: the source is multiplied by what a bare tube emits at the other voltage over what it emits at the stated one,
  as flat filters cancel;
- filter: the source is multiplied by exp(-mu t), with t added or, where negative, missing;
- threshold: of what all channels together count at an energy, the part above a threshold is a function of energy that
  moves along with the threshold. The lowest threshold stays, as the file holds no photons below it.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float

from phantomgen.dataset.reader import Dataset
from phantomgen.dataset.spectral_model import Spectra, in_basis
from recon.calibration.scoring import Vector
from recon.calibration.spectrum_file import check_plain
from spectra.channel_model import Tube
from spectra.materials.material import Material

# Room for a higher voltage: energies above the stated one, and the width of their bins [keV].
_ROOM, _WIDTH = 10.0, 1.0


@dataclass(frozen=True, eq=False)
class Perturbation:
    """Spectral model of a dataset as a function of its errors; see the module.

    Parameters
    ----------
    stated : the model with room for a higher voltage
    tube, voltage : anode and stated voltage [kV]; None where the dataset names no tube, and then the voltage stays
    filter : material that the filter has more or less of
    """

    stated: Spectra
    tube: Tube
    voltage: float | None
    filter: Material

    @classmethod
    def of(cls, dataset: Dataset, sheet: Material, voltage: float | None = None) -> "Perturbation":
        """Take the stated model of a dataset.

        Parameters
        ----------
        dataset : open dataset
        sheet : material that the filter has more or less of
        voltage : of the stated spectrum, where it is not that of the file [kV]

        Returns
        -------
        the model

        Raises
        ------
        InputError
            When the dataset does not count photons, or its beam differs over the panel.
        """
        check_plain(dataset)
        anode, of_file = dataset.tube
        stated = of_file if voltage is None else voltage
        if anode is None or of_file is None or stated is None or abs(stated - dataset.spectra.edges[-1]) >= _ROOM:
            return cls(dataset.spectra, Tube(), None, sheet)
        return cls(with_room(dataset.spectra), Tube(anode), stated, sheet)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        first = ("filter",) if self.voltage is None else ("voltage", "filter")
        return (*first, *(f"threshold_{c}" for c in range(1, len(self.stated.channels))))

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the parameters."""
        units = {"voltage": "kV", "filter": "mm"}
        return tuple(units.get(name, "keV") for name in self.names)

    def spectra(self, errors: Vector) -> Spectra:
        """Compute the spectral model with other values than the stated ones.

        Parameters
        ----------
        errors : true less stated values, in the order of `names` [kV, mm, keV]

        Returns
        -------
        the model, whose photons are not scaled
        """
        shift = 0.0 if self.voltage is None else float(errors[0])
        count = len(self.stated.channels) - 1
        thickness, thresholds = float(errors[-1 - count]), errors[len(errors) - count :]
        source = self._passed * self._photons(shift) * np.exp(-thickness * self._mu)
        return replace(
            self.stated,
            source=source,
            response=_shifted(self.stated.response, self.stated.edges, thresholds),
            lower=self.stated.lower + np.append(0.0, thresholds),
            upper=self.stated.upper + np.append(thresholds, shift),
        )

    def corrected(self, errors: Vector, stated: Spectra) -> Spectra:
        """Compute the spectral model with other values than the stated ones, for a dataset.

        Parameters
        ----------
        errors : true less stated values, in the order of `names` [kV, mm, keV]
        stated : model of the dataset

        Returns
        -------
        the model without empty bins at its end, with the stated number of counts, and bins cut at edges
        """
        found = self.spectra(errors)
        last = int(np.flatnonzero(found.source)[-1]) + 1
        cut = replace(
            found,
            energy=found.energy[:last],
            edges=found.edges[: last + 1],
            source=found.source[:last] * (stated.weights.sum() / found.weights.sum()),
            response=np.ascontiguousarray(found.response[:, :last]),
            basis_values=found.basis_values[:, :last],
        )
        return in_basis(cut, stated.basis)

    def _photons(self, shift: float) -> Float[np.ndarray, " energy"]:
        """Photons of the bare tube at the stated voltage and another; 1 without a tube."""
        if self.voltage is None:
            return np.ones(len(self.stated.energy))
        return self.tube.photons(self.voltage + shift, self.stated.edges)

    @cached_property
    def _passed(self) -> Float[np.ndarray, " energy"]:
        """Stated source over the bare tube; above the stated voltage as in the highest bin below."""
        bare, source = self._photons(0.0), self.stated.source
        passed = np.divide(source, bare, out=np.zeros_like(source), where=bare > 0)
        last = np.flatnonzero(source)[-1]
        passed[last + 1 :] = passed[last]
        return passed

    @cached_property
    def _mu(self) -> Float[np.ndarray, " energy"]:
        """Attenuation of the filter [1/mm]."""
        return self.filter.attenuation(self.stated.energy)


def with_room(spectra: Spectra) -> Spectra:
    """Append bins without photons above the highest energy, which respond as the highest bin.

    Parameters
    ----------
    spectra : spectral model

    Returns
    -------
    the same model on a longer grid
    """
    above = spectra.edges[-1] + np.arange(_WIDTH, _ROOM + _WIDTH / 2, _WIDTH)
    edges = np.append(spectra.edges, above)
    energy = np.append(spectra.energy, above - _WIDTH / 2)
    more = np.repeat(spectra.response[:, -1:], len(above), axis=1)
    return replace(
        spectra,
        energy=energy,
        edges=edges,
        source=np.append(spectra.source, np.zeros(len(above))),
        response=np.concatenate([spectra.response, more], axis=1),
        basis_values=spectra.basis.evaluate(energy),
    )


def _shifted(
    response: Float[np.ndarray, "channel energy"],
    edges: Float[np.ndarray, " energy_plus_1"],
    shifts: Float[np.ndarray, " threshold"],
) -> Float[np.ndarray, "channel energy"]:
    """Response whose thresholds, all but the lowest, are moved up [keV]."""
    above = np.cumsum(response[::-1], axis=0)[::-1]
    together = above[0]
    width, moved = np.diff(edges), [together]
    for counted, shift in zip(above[1:], shifts, strict=True):
        part = np.divide(counted, together, out=np.zeros_like(counted), where=together > 0)
        integral = np.append(0.0, np.cumsum(part * width))
        ends = edges - shift
        beyond = np.minimum(ends - edges[0], 0) * part[0] + np.maximum(ends - edges[-1], 0) * part[-1]
        moved.append(together * np.diff(np.interp(ends, edges, integral) + beyond) / width)
    return np.maximum(np.stack(moved) - np.stack([*moved[1:], np.zeros_like(together)]), 0.0)
