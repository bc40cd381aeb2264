"""From what is stated about a beam and a detector to the spectral model of a dataset."""

import re
from collections.abc import Sequence
from dataclasses import replace

from phantomgen.dataset.spectral_model import Spectra
from phantomgen.importers.scans.stated import Stated
from phantomgen.scene.input_files.spectrum_table import read_source
from spectra.basis.basis import Basis, BasisFunction
from spectra.detector.detector import AnyDetector, Detector
from spectra.detector.scintillator import SCINTILLATORS, EnergyIntegrating
from spectra.elements.attenuation import edge_energy, mass_fractions
from spectra.errors import InputError
from spectra.materials.material import Material
from spectra.source.source import Filter, Source

_MILLIMETRES = {"um": 1e-3, "mm": 1.0, "cm": 10.0}
_LAYER = re.compile(r"\s*([0-9.eE+-]*[0-9.])\s*(um|mm|cm)\s+(\S.*?)\s*$")
_PLAIN = ("photoelectric", "compton")
# One channel has one unknown per ray: amounts of one material, whose curve then corrects the hardening of the beam.
_SINGLE = "water"


def spectra_of(stated: Stated, channels: Sequence[str], basis: Sequence[str] = ()) -> Spectra:
    """Create the spectral model.

    Parameters
    ----------
    stated : spectrum, filters and detector
    channels : names of the channels of the scan
    basis : names of basis functions: ``photoelectric``, ``compton``, an element with a K edge, or a material; where
        left out, the first two, or water where there is one channel

    Returns
    -------
    the spectral model with the photons that are stated, 1 where none are

    Raises
    ------
    InputError
        When what is stated cannot be, or does not fit the number of channels.
    """
    source = _source(stated)
    detector = _detector(stated, source)
    if len(detector) != len(channels):
        kind = f"{len(detector)} thresholds are" if stated.thresholds is not None else "one scintillator is"
        raise InputError(
            f"the scan has {len(channels)} channel{'s' * (len(channels) > 1)} ({', '.join(channels)}), but {kind} "
            "stated: give the lower limit of each channel by --thresholds"
        )
    spectra = Spectra.of(source, detector, basis_of(basis, len(channels)))
    return replace(spectra, channels=tuple(channels))


def basis_of(names: Sequence[str], channels: int) -> Basis:
    """Create the basis functions.

    Parameters
    ----------
    names : as in `spectra_of`
    channels : number of channels

    Returns
    -------
    the basis

    Raises
    ------
    InputError
        When there are more functions than channels, or a name is unknown.
    """
    names = tuple(names) or (_PLAIN if channels > 1 else (_SINGLE,))
    if len(names) > channels:
        raise InputError(
            f"--basis names {len(names)} functions, but {channels} channel{'s' * (channels > 1)} can tell at most "
            f"{channels} apart"
        )
    return Basis(tuple(_function(name) for name in names))


def layers_of(text: str, option: str) -> list[tuple[float, str]]:
    """Parse layers such as ``2.5 mm Al + 0.2 mm Cu``.

    Parameters
    ----------
    text : the layers; ``none`` for no layer
    option : its name, for the message

    Returns
    -------
    thickness [mm] and material of each

    Raises
    ------
    InputError
        When the text is something else.
    """
    if text.strip().lower() == "none":
        return []
    found = [_LAYER.match(part) for part in text.split("+")]
    if not all(found):
        raise InputError(f"{option} {text!r}: write thickness, unit and material, such as '2.5 mm Al + 0.2 mm Cu'")
    return [(float(one[1]) * _MILLIMETRES[one[2]], one[3]) for one in found if one]


def _source(stated: Stated) -> Source:
    """The source behind its filters."""
    photons = 1.0 if stated.photons is None else stated.photons
    if not 0 < photons < float("inf"):
        raise InputError(f"--photons must be a positive number, got {photons:g}")
    filters = [
        Filter(Material(name, composition=name), thickness)
        for thickness, name in layers_of(stated.filters or "none", "--filter")
    ]
    if stated.spectrum is not None:
        return read_source(stated.spectrum, "per_bin", "centres").behind(filters).scaled(photons)
    if stated.energy is not None:
        return Source.monochromatic(stated.energy, photons)
    return Source.tube(float(stated.kvp or 0), photons, stated.anode_angle, filters, stated.anode)


def _detector(stated: Stated, source: Source) -> AnyDetector:
    """Counters between thresholds, or a scintillator."""
    if stated.thresholds is not None and stated.scintillator is not None:
        raise InputError("--thresholds belong to photon-counting detectors and --scintillator to others: give one")
    if stated.scintillator is None:
        (thickness, name), *_ = layers_of(stated.sensor, "--sensor") or [(0.0, "")]
        return Detector.photon_counting(stated.thresholds or (), source.maximum, name, thickness)
    text = stated.scintillator.strip()
    if text in SCINTILLATORS:
        return EnergyIntegrating.behind(source, text)
    if not text[:1].isdigit():
        raise InputError(
            f"--scintillator {text!r}: write one of {', '.join(SCINTILLATORS)}, or thickness, unit and material, such "
            "as '0.6 mm CsI'"
        )
    (thickness, name), *_ = layers_of(text, "--scintillator")
    material = name if name in SCINTILLATORS else Material(name, composition=name)
    return EnergyIntegrating.behind(source, material, thickness)


def _function(name: str) -> BasisFunction:
    """One basis function by its name."""
    if name in _PLAIN:
        return BasisFunction(name)
    try:
        edge_energy(name)
    except InputError:
        try:
            mass_fractions(name)
        except InputError as error:
            raise InputError(f"--basis {name}: {error}") from None
        return BasisFunction("material", name=name, composition=name)
    return BasisFunction("element", element=name)
