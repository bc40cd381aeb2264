"""Materials by name that xraylib lacks: tissues, minerals, plastics by their usual names, detector crystals.

Tissues are adult averages of ICRU Report 44, "Tissue Substitutes in Radiation Dosimetry and Measurement" (1989), which
Report 46 (1992) repeats (after Woodard & White 1986, doi:10.1259/0007-1285-59-708-1209); mass fractions are printed to
0.1 %, and those of every entry sum to 100 %. Real organs vary in fat and water by more than the figures suggest.
"""

import difflib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache

_ICRU_44 = "ICRU Report 44 (1989)"


@dataclass(frozen=True)
class Entry:
    """A material with a name.

    Parameters
    ----------
    density : [g/cm^3]
    composition : formula, NIST compound name or mass fractions
    source : where the numbers come from
    """

    density: float
    composition: str | Mapping[str, float]
    source: str


def _tissue(density: float, **percent: float) -> Entry:
    """From mass fractions in per cent."""
    return Entry(density, {element: round(value / 100, 4) for element, value in percent.items()}, _ICRU_44)


def _nist(density: float, name: str) -> Entry:
    """Another name of a NIST compound."""
    return Entry(density, name, f"NIST: {name}")


TISSUES = {
    "adipose": _tissue(0.95, H=11.4, C=59.8, N=0.7, O=27.8, Na=0.1, S=0.1, Cl=0.1),
    "blood": _tissue(1.06, H=10.2, C=11.0, N=3.3, O=74.5, Na=0.1, P=0.1, S=0.2, Cl=0.3, K=0.2, Fe=0.1),
    "brain": _tissue(1.04, H=10.7, C=14.5, N=2.2, O=71.2, Na=0.2, P=0.4, S=0.2, Cl=0.3, K=0.3),
    "breast": _tissue(1.02, H=10.6, C=33.2, N=3.0, O=52.7, Na=0.1, P=0.1, S=0.2, Cl=0.1),
    "cartilage": _tissue(1.10, H=9.6, C=9.9, N=2.2, O=74.4, Na=0.5, P=2.2, S=0.9, Cl=0.3),
    "cortical bone": _tissue(1.92, H=3.4, C=15.5, N=4.2, O=43.5, Na=0.1, Mg=0.2, P=10.3, S=0.3, Ca=22.5),
    "cranium": _tissue(1.61, H=5.0, C=21.2, N=4.0, O=43.5, Na=0.1, Mg=0.2, P=8.1, S=0.3, Ca=17.6),
    "eye lens": _tissue(1.07, H=9.6, C=19.5, N=5.7, O=64.6, Na=0.1, P=0.1, S=0.3, Cl=0.1),
    "heart": _tissue(1.05, H=10.4, C=13.9, N=2.9, O=71.8, Na=0.1, P=0.2, S=0.2, Cl=0.2, K=0.3),
    "kidney": _tissue(1.05, H=10.3, C=13.2, N=3.0, O=72.4, Na=0.2, P=0.2, S=0.2, Cl=0.2, K=0.2, Ca=0.1),
    "liver": _tissue(1.06, H=10.2, C=13.9, N=3.0, O=71.6, Na=0.2, P=0.3, S=0.3, Cl=0.2, K=0.3),
    "lung": _tissue(1.05, H=10.3, C=10.5, N=3.1, O=74.9, Na=0.2, P=0.2, S=0.3, Cl=0.3, K=0.2),
    "muscle": _tissue(1.05, H=10.2, C=14.3, N=3.4, O=71.0, Na=0.1, P=0.2, S=0.3, Cl=0.1, K=0.4),
    "pancreas": _tissue(1.04, H=10.6, C=16.9, N=2.2, O=69.4, Na=0.2, P=0.2, S=0.1, Cl=0.2, K=0.2),
    "red marrow": _tissue(1.03, H=10.5, C=41.4, N=3.4, O=43.9, P=0.1, S=0.2, Cl=0.2, K=0.2, Fe=0.1),
    "skin": _tissue(1.09, H=10.0, C=20.4, N=4.2, O=64.5, Na=0.2, P=0.1, S=0.2, Cl=0.3, K=0.1),
    "soft tissue": _tissue(1.06, H=10.2, C=14.3, N=3.4, O=70.8, Na=0.2, P=0.3, S=0.3, Cl=0.2, K=0.3),
    "spleen": _tissue(1.06, H=10.3, C=11.3, N=3.2, O=74.1, Na=0.1, P=0.3, S=0.2, Cl=0.2, K=0.3),
    "spongiosa": _tissue(
        1.18, H=8.5, C=40.4, N=2.8, O=36.7, Na=0.1, Mg=0.1, P=3.4, S=0.2, Cl=0.2, K=0.1, Ca=7.4, Fe=0.1
    ),
    "thyroid": _tissue(1.05, H=10.4, C=11.9, N=2.4, O=74.5, Na=0.2, P=0.1, S=0.1, Cl=0.2, K=0.1, I=0.1),
    "yellow marrow": _tissue(0.98, H=11.5, C=64.4, N=0.7, O=23.1, Na=0.1, S=0.1, Cl=0.1),
}

OTHERS = {
    "water": _nist(1.0, "Water, Liquid"),
    "air": _nist(0.001205, "Air, Dry (near sea level)"),
    "hydroxyapatite": Entry(3.16, "Ca10P6O26H2", "Ca5(PO4)3(OH), X-ray density"),
    "Delrin": Entry(1.42, "CH2O", "the Phantom Laboratory, Catphan manual"),
    "PMP": Entry(0.83, "C6H12", "polymethylpentene; the Phantom Laboratory, Catphan manual"),
    "PC": _nist(1.2, "Polycarbonate (Makrolon, Lexan)"),
    "PE": _nist(0.94, "Polyethylene"),
    "PET": _nist(1.4, "Polyethylene Terephthalate (Mylar)"),
    "PMMA": _nist(1.19, "Polymethyl Methacralate (Lucite, Perspex)"),
    "POM": _nist(1.425, "Polyoxymethylene"),
    "PP": _nist(0.9, "Polypropylene"),
    "PS": _nist(1.06, "Polystyrene"),
    "PTFE": _nist(2.2, "Polytetrafluoroethylene (Teflon)"),
    "PVC": _nist(1.3, "Polyvinyl Chloride"),
}

_CRYSTAL = "single crystal, CRC Handbook"
DETECTORS = {
    "CdTe": Entry(5.85, "CdTe", _CRYSTAL),
    "Cd0.9Zn0.1Te": Entry(5.78, "Cd0.9Zn0.1Te", _CRYSTAL),
    "CZT": Entry(5.78, "Cd0.9Zn0.1Te", "Cd0.9Zn0.1Te, single crystal"),
    "GaAs": Entry(5.32, "GaAs", _CRYSTAL),
    "CsI": Entry(4.51, "CsI", _CRYSTAL),
    "GOS": Entry(7.34, "Gd2O2S", "gadolinium oxysulfide, X-ray density; screens are packed less densely"),
    "CdWO4": Entry(7.9, "CdWO4", _CRYSTAL),
}

GROUPS = {"tissues": TISSUES, "plastics, minerals and others": OTHERS, "detectors": DETECTORS}
LIBRARY = {name: entry for group in GROUPS.values() for name, entry in group.items()}

# In order of the atomic number, from 1 to 98.
_NAMES = """
hydrogen helium lithium beryllium boron carbon nitrogen oxygen fluorine neon sodium magnesium aluminium silicon
phosphorus sulfur chlorine argon potassium calcium scandium titanium vanadium chromium manganese iron cobalt nickel
copper zinc gallium germanium arsenic selenium bromine krypton rubidium strontium yttrium zirconium niobium molybdenum
technetium ruthenium rhodium palladium silver cadmium indium tin antimony tellurium iodine xenon caesium barium
lanthanum cerium praseodymium neodymium promethium samarium europium gadolinium terbium dysprosium holmium erbium
thulium ytterbium lutetium hafnium tantalum tungsten rhenium osmium iridium platinum gold mercury thallium lead bismuth
polonium astatine radon francium radium actinium thorium protactinium uranium neptunium plutonium americium curium
berkelium californium
"""
ELEMENTS = tuple(_NAMES.split())


def near(word: str, known: Iterable[str]) -> str | None:
    """Return the known name that is closest to a word, upper and lower case ignored.

    A word that begins a name is close, too: ``Water`` is ``Water, Liquid``.

    Parameters
    ----------
    word : the word
    known : known names

    Returns
    -------
    the name; None where none is close
    """
    names = list(known)
    folded = [name.casefold() for name in names]
    wanted = word.strip().casefold()
    close = difflib.get_close_matches(wanted, folded, 1, cutoff=0.75)
    begun = [name for name in folded if len(wanted) > 2 and name.startswith(wanted)]
    found = (close or begun)[:1]
    return names[folded.index(found[0])] if found else None


@lru_cache(maxsize=1)
def _atomic_numbers() -> dict[str, int]:
    """Atomic numbers by the English name of the element."""
    numbers = {name: i + 1 for i, name in enumerate(ELEMENTS)}
    return {**numbers, "aluminum": 13, "sulphur": 16, "cesium": 55}


def element_number(word: str) -> int | None:
    """Return the atomic number of an element by its English name.

    Parameters
    ----------
    word : the name

    Returns
    -------
    atomic number; None for any other word
    """
    return _atomic_numbers().get(word.strip().casefold())
