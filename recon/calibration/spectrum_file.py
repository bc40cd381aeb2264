"""Files of calibrated channels: parameters with uncertainties, and sensitivities for a fit, in place of a dataset's."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from jaxtyping import Float

from phantomgen.dataset.reader import Dataset
from phantomgen.dataset.spectral_model import Spectra, in_basis
from phantomgen.runtime.yaml_text import YamlTextError, parse_yaml
from spectra.errors import InputError

KIND = "channel sensitivities"


@dataclass(frozen=True, eq=False)
class Sensitivities:
    """Source and response of all channels on energy bins, as a dataset stores them.

    Parameters
    ----------
    edges : of the bins [keV]
    energy : mean energy of each bin [keV]
    source : photons per bin, in any unit
    response : counts per photon
    lower, upper : limits of the channels [keV]
    """

    edges: Float[np.ndarray, " energy_plus_1"]
    energy: Float[np.ndarray, " energy"]
    source: Float[np.ndarray, " energy"]
    response: Float[np.ndarray, "channel energy"]
    lower: Float[np.ndarray, " channel"]
    upper: Float[np.ndarray, " channel"]

    def __post_init__(self) -> None:
        bins, channels = len(self.energy), len(self.response)
        shapes = [self.edges.shape, self.source.shape, self.response.shape, self.lower.shape, self.upper.shape]
        if shapes != [(bins + 1,), (bins,), (channels, bins), (channels,), (channels,)]:
            raise InputError(f"energy_edges, energy, source, response, lower and upper do not fit together: {shapes}")
        if (
            not (np.diff(self.edges) > 0).all()
            or not ((self.energy >= self.edges[:-1]) & (self.energy <= self.edges[1:])).all()
        ):
            raise InputError("energy_edges must ascend, and every energy must lie in its bin")
        if not ((self.source >= 0).all() and (self.response >= 0).all() and (self.response @ self.source > 0).all()):
            raise InputError("source and response must not be negative, and every channel must count something")


def with_sensitivities(dataset: Dataset, known: Sensitivities) -> Dataset:
    """Return a dataset with other channel sensitivities than its file states; the basis functions are kept.

    Parameters
    ----------
    dataset : open dataset
    known : sensitivities of its channels; only their shape matters, as flats tell how much each channel counts

    Returns
    -------
    the same open file

    Raises
    ------
    InputError
        When the number of channels differs, or the detector does not count photons, or the beam differs over the panel.
    """
    spectra = dataset.spectra
    check_plain(dataset)
    if len(known.response) != len(spectra.channels):
        raise InputError(
            f"{dataset.path} has {len(spectra.channels)} channels, the sensitivities are of {len(known.response)}"
        )
    source = known.source * (spectra.weights.sum() / (known.source * known.response).sum())
    changed = replace(
        spectra,
        energy=known.energy,
        edges=known.edges,
        source=source,
        response=known.response,
        basis_values=spectra.basis.evaluate(known.energy),
        lower=known.lower,
        upper=known.upper,
    )
    return dataset.with_spectra(in_basis(changed, spectra.basis))


def check_plain(dataset: Dataset) -> None:
    """Refuse a dataset whose spectral model has more than one source spectrum, counts, and dead time.

    Parameters
    ----------
    dataset : open dataset

    Raises
    ------
    InputError
        When it is so.
    """
    spectra = dataset.spectra
    if spectra.profile is not None:
        parts = ", ".join(spectra.profile.names)
        raise InputError(f"{dataset.path}: the beam differs over the panel ({parts}), its spectrum cannot be replaced")
    if spectra.variance is not None:
        raise InputError(f"{dataset.path}: its detector sums up energies; only counting channels can be calibrated")
    if spectra.pulses is not None:
        raise InputError(
            f"{dataset.path}: its pulses pile up; the spectral model of such a scan cannot be replaced or refined"
        )


def sensitivities_of(spectra: Spectra) -> Sensitivities:
    """Return the sensitivities of a spectral model.

    Parameters
    ----------
    spectra : of a dataset

    Returns
    -------
    the sensitivities
    """
    return Sensitivities(spectra.edges, spectra.energy, spectra.source, spectra.response, spectra.lower, spectra.upper)


def write_spectrum(path: Path, about: dict[str, Any], known: Sensitivities, channels: tuple[str, ...]) -> None:
    """Write parameters and sensitivities as YAML.

    Parameters
    ----------
    path : file to write
    about : what was estimated, of plain values
    known : sensitivities
    channels : names of the channels

    Raises
    ------
    InputError
        When the file cannot be written.
    """
    table = {
        "channels": list(channels),
        "lower_keV": _rounded(known.lower),
        "upper_keV": _rounded(known.upper),
        "energy_edges_keV": _rounded(known.edges),
        "energy_keV": _rounded(known.energy),
        "source": _rounded(known.source),
        "response": [_rounded(row) for row in known.response],
    }
    content = {"version": 1, "kind": KIND, **about, "spectra": table}
    text = yaml.dump(content, sort_keys=False, default_flow_style=None, width=120)
    part = path.with_name(path.name + ".part")
    try:
        part.write_text(text, encoding="utf-8")
        part.replace(path)
    except OSError as error:
        raise InputError(f"{path} cannot be written: {error.strerror}") from None


def read_spectrum(path: Path) -> Sensitivities:
    """Read the sensitivities of a file that `recon calibrate` wrote.

    Parameters
    ----------
    path : YAML file

    Returns
    -------
    the sensitivities

    Raises
    ------
    InputError
        When the file is no such file.
    """
    try:
        values = parse_yaml(path.read_text(encoding="utf-8")).values
    except OSError as error:
        raise InputError(f"{path} cannot be read as a spectrum: {error.strerror}") from None
    except (YamlTextError, UnicodeDecodeError):
        raise InputError(f"{path} cannot be read as a spectrum: it is no YAML text") from None
    if not isinstance(values, dict) or values.get("kind") != KIND or not isinstance(values.get("spectra"), dict):
        raise InputError(f"{path} holds no channel sensitivities: `recon calibrate` writes such files")
    table = values["spectra"]
    try:
        columns = ("energy_edges_keV", "energy_keV", "source", "response", "lower_keV", "upper_keV")
        arrays = [np.array(table[name], dtype=np.float64) for name in columns]
    except KeyError as error:
        raise InputError(f"{path}: spectra.{error.args[0]} is missing") from None
    except (ValueError, TypeError):
        raise InputError(
            f"{path}: spectra must hold lists of numbers, of equal length in all rows of response"
        ) from None
    if [a.ndim for a in arrays] != [1, 1, 1, 2, 1, 1] or not all(np.isfinite(a).all() for a in arrays):
        raise InputError(f"{path}: spectra.{columns[0]} and the others must be lists of finite numbers")
    try:
        return Sensitivities(*arrays)
    except InputError as error:
        raise InputError(f"{path}: spectra: {error}") from None


def is_spectrum(path: Path) -> bool:
    """Tell whether a file begins as those of `write_spectrum` do.

    Parameters
    ----------
    path : of a file

    Returns
    -------
    whether it is one
    """
    with path.open("rb") as file:
        return KIND.encode() in file.read(200)


def _rounded(values: Float[np.ndarray, " n"]) -> list[float]:
    """Numbers with ten digits."""
    return [float(f"{value:.10g}") for value in values]
