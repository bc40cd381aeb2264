"""The format of a dataset as one table, by which arrays are checked and which `phantomgen schema` prints.

Letters are sizes: V views, C channels, R rows, K columns, E energy bins, M basis functions, P absorbers of the beam
profile, F flats, D darks, S materials, G cycles, N signals, Q phases, H groups of pulse heights. The first array that
has a letter says how large it is.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from math import inf
from typing import Any, Literal

import h5py
import numpy as np

from phantomgen.dataset.checks.door import find_array, find_group, names_in, readable, value_at

# Far more than any scanner has, and far less than what overflows: mm, keV, relative numbers.
_FAR, _HARD, _MANY = 1e7, 1e5, 1e12
_DETECTOR, _SPECTRA, _GRID = "/entry/instrument/detector", "/entry/spectra", "/entry/reconstruction_grid"


@dataclass(frozen=True)
class Field:
    """An array of the format.

    Parameters
    ----------
    path : from the root; ``<channel>`` and ``<scheme>`` stand for every name
    kind : of the values; ``real`` takes whole numbers, too
    shape : sizes along the axes; alternatives are separated by a bar
    units : of the values
    about : what it is
    low, high : limits of the values
    nan : whether values may be NaN, which says that there is none
    optional : whether a file may lack it
    large : whether it is checked frame by frame, when it is read
    """

    path: str
    kind: Literal["real", "whole", "text"]
    shape: str
    units: str
    about: str
    low: float = -inf
    high: float = inf
    nan: bool = False
    optional: bool = False
    large: bool = False

    @property
    def values(self) -> str:
        """Values that are right, in words."""
        if self.kind == "text":
            return "text"
        what = "whole numbers" if self.kind == "whole" else "numbers"
        return what + (f" from {self.low:g} to {self.high:g}" if self.high < inf else "")


_TINY = 1e-9  # least size of what must be positive
ENTRY = (
    Field("/entry/title", "text", "", "", "name of the scan"),
    Field(f"{_DETECTOR}/data", "real", "V,C,R,K", "counts", "int32, or float32 without noise; keV of sums", large=True),
    Field(f"{_DETECTOR}/x_pixel_size", "real", "", "mm", "pitch along columns", _TINY, _FAR),
    Field(f"{_DETECTOR}/y_pixel_size", "real", "", "mm", "pitch along rows", _TINY, _FAR),
    Field(f"{_DETECTOR}/distance", "real", "", "mm", "sample to panel", -_FAR, _FAR, optional=True),
    Field(f"{_DETECTOR}/dead_time", "real", "", "ns", "of a pixel", 0, _MANY, optional=True),
    Field(f"{_DETECTOR}/count_time", "real", "", "ms", "of a view", 0, _MANY, optional=True),
    Field(f"{_DETECTOR}/dead_time_model", "text", "", "", "paralyzable or not", optional=True),
    Field(f"{_DETECTOR}/counters", "text", "", "", "bins, or cumulative: channels count above", optional=True),
    Field("/entry/data/channel", "text", "C", "", "names of the channels"),
    Field(f"{_DETECTOR}/<channel>_channel/threshold_energy", "real", "", "keV", "lower limit", 0, _HARD),
    Field(f"{_DETECTOR}/<channel>_channel/upper_energy", "real", "", "keV", "upper limit", 0, _HARD),
    Field(
        f"{_DETECTOR}/<channel>_channel/pixel_mask", "whole", "R,K", "",
        "0 for a pixel that measures, else bits of NXdetector: 1 dead, 3 hot, 6 in a cluster",
        optional=True, large=True,
    ),
    Field("/entry/instrument/flat/data", "real", "F,C,R,K", "counts", "open-beam frames", optional=True, large=True),
    Field("/entry/instrument/dark/data", "real", "D,C,R,K", "counts", "frames without beam", optional=True, large=True),
    Field("/entry/instrument/source/voltage", "real", "", "kV", "of the tube", 0, _HARD, optional=True),
    Field("/entry/instrument/source/target_material", "text", "", "", "of the tube", optional=True),
    Field("/entry/sample/rotation_angle", "real", "V", "degree", "NaN where a view has none", -1e9, 1e9, nan=True),
    Field("/entry/geometry/kind", "text", "", "", "circular, helical, laminography, parallel or free"),
    Field("/entry/geometry/source", "real", "V,3", "mm", "in cone beams", -_FAR, _FAR, optional=True),
    Field("/entry/geometry/ray_direction", "real", "V,3", "", "in parallel beams: unit vectors", -2, 2, optional=True),
    Field("/entry/geometry/panel_center", "real", "V,3", "mm", "of every view", -_FAR, _FAR),
    Field("/entry/geometry/column_step", "real", "V,3", "mm", "from a pixel to the next column", -_FAR, _FAR),
    Field("/entry/geometry/row_step", "real", "V,3", "mm", "from a pixel to the next row", -_FAR, _FAR),
    Field("/entry/geometry/curvature_radius", "real", "", "mm", "of a curved panel", 0, _FAR, optional=True),
    Field("/entry/geometry/modules", "whole", "", "", "flat parts of a curved panel", 1, _MANY, optional=True),
    Field(f"{_SPECTRA}/energy", "real", "E", "keV", "mean energy of each bin", _TINY, _HARD),
    Field(f"{_SPECTRA}/energy_edges", "real", "E+1", "keV", "ascending edges of the bins", 0, _HARD),
    Field(f"{_SPECTRA}/source", "real", "E", "photons", "per pixel and view, at the panel's centre", 0, 1e30),
    Field(f"{_SPECTRA}/response", "real", "C,E", "", "counts per photon", 0, _MANY),
    Field(f"{_SPECTRA}/variance", "real", "C,E", "", "of signals per photon, no counts", 0, _MANY, optional=True),
    Field(f"{_DETECTOR}/pulse_response", "real", "H,E", "", "pulses per photon", 0, _MANY, optional=True),
    Field(f"{_DETECTOR}/pulse_edges", "real", "H+1", "keV", "of pulse heights that add", 0, _HARD, optional=True),
    Field(f"{_SPECTRA}/basis_name", "text", "M", "", "names of the basis functions"),
    Field(f"{_SPECTRA}/basis_kind", "text", "M", "", "kinds of the basis functions"),
    Field(f"{_SPECTRA}/basis", "real", "M,E", "", "basis functions in the bins", -_MANY, _MANY),
    Field(f"{_SPECTRA}/edge_energy", "real", "M", "keV", "NaN where there is no edge", 0, _HARD, nan=True),
    Field(f"{_SPECTRA}/edge_width", "real", "M", "keV", "NaN where there is no edge", 0, _HARD, nan=True),
    Field(f"{_SPECTRA}/element", "text", "M", "", "element of an edge"),
    Field(f"{_SPECTRA}/normalisation_energy", "real", "M", "keV", "where a function is 1", 0, _HARD, True, True),
    Field(f"{_SPECTRA}/reference_energy", "real", "", "keV", "of the basis", _TINY, _HARD),
    Field(f"{_SPECTRA}/basis_composition", "text", "M", "", "of materials, such as H 0.11 O 0.89", optional=True),
    Field(f"{_SPECTRA}/profile/name", "text", "P", "", "absorbers of bowtie and heel effect", optional=True),
    Field(f"{_SPECTRA}/profile/mu", "real", "P,E", "1/mm", "their attenuation", -_MANY, _MANY, optional=True),
    Field(
        f"{_SPECTRA}/profile/thickness", "real", "P,R,K", "mm",
        "beyond that at the panel's centre; the beam to a pixel is source x exp(-sum_p mu thickness)", -_FAR, _FAR,
        optional=True,
    ),
    Field("/entry/exposure/scale", "real", "V | V,C", "", "tube output, 0 where a channel has no such view", 0, _MANY),
    Field("/entry/time/time", "real", "V", "s", "of each view", -_MANY, _MANY, optional=True),
    Field("/entry/time/phase", "whole", "V", "", "of each view, from 0", 0, 1e6, optional=True),
    Field("/entry/time/phases", "whole", "", "", "number of phases", 1, 1e6, optional=True),
    Field("/entry/time/cycle_name", "text", "G", "", "breathing, heartbeat ...", optional=True),
    Field("/entry/time/cycle", "real", "G,V", "", "position in each cycle", 0, 1, optional=True),
    Field("/entry/splits/<scheme>/train", "whole", "*", "", "views; @default names the scheme", 0, 1e9),
    Field("/entry/splits/<scheme>/test", "whole", "*", "", "views", 0, 1e9),
    Field("/entry/splits/<scheme>/val", "whole", "*", "", "views", 0, 1e9),
    Field(f"{_GRID}/shape", "whole", "3", "", "voxels along z, y, x", 1, 1e6),
    Field(f"{_GRID}/spacing", "real", "3", "mm", "along z, y, x", _TINY, _FAR),
    Field(f"{_GRID}/origin", "real", "3", "mm", "centre of voxel 0", -_FAR, _FAR),
)  # fmt: skip
TRUTH = (
    Field("/truth/basis/basis", "text", "M", "", "names of the basis functions"),
    Field("/truth/grid/shape", "whole", "3", "", "voxels along z, y, x", 1, 1e6),
    Field("/truth/grid/spacing", "real", "3", "mm", "along z, y, x", _TINY, _FAR),
    Field("/truth/grid/origin", "real", "3", "mm", "centre of voxel 0", -_FAR, _FAR),
    Field("/truth/basis/data", "real", "M,z,y,x", "1/mm", "basis volumes", large=True),
    Field("/truth/materials/name", "text", "S", "", "names of the materials"),
    Field("/truth/materials/density", "real", "S", "g/cm^3", "NaN where none is stated", 0, _HARD, nan=True),
    Field("/truth/materials/composition", "text", "S", "", "formula, or mass fractions as JSON"),
    Field("/truth/materials/coefficients", "real", "S,M", "1/mm", "of the basis", -_HARD, _HARD),
    Field("/truth/materials/kind", "text", "S", "", "explicit or fitted", optional=True),
    Field("/truth/materials/fit_error", "real", "S", "", "rms, relative", 0, _HARD, nan=True, optional=True),
    Field("/truth/materials/fit_window", "real", "2", "keV", "energies of the fit", 0, _HARD, optional=True),
    Field("/truth/materials/fit_weights", "text", "", "", "what each energy weighs", optional=True),
    Field("/truth/fractions", "whole", "S,z,y,x", "", "65535 is the whole voxel", large=True),
    Field("/truth/labels", "whole", "z,y,x", "", "0 background, i + 1 material i", optional=True, large=True),
    Field("/truth/expected", "real", "V,C,R,K", "counts", "without noise", optional=True, large=True),
    Field("/truth/phases/data", "real", "Q,M,z,y,x", "1/mm", "basis volumes of each phase; /truth/basis is their mean",
          optional=True, large=True),
    Field("/truth/phases/fractions", "whole", "Q,S,z,y,x", "", "65535 is the whole voxel", optional=True, large=True),
    Field("/truth/time/signal_name", "text", "N", "", "what drives objects and materials", optional=True),
    Field("/truth/time/signal", "real", "N,V", "", "its value at each view", -_MANY, _MANY, optional=True),
    Field("/truth/motion/pose", "real", "V,4,4", "mm", "from the sample at rest to where it was", -_FAR, _FAR,
          optional=True),
)  # fmt: skip
_UNCHECKED = """\
/entry/instrument/source                 further: probe, type, charge per view [mA*s]
/entry/process_<n>_<what>                program, version, date, sequence_index, command, seed, environment; of a later
                                         step than the first also done (phrases) and settings (JSON)
/truth/scene, /truth/plan                the scene as YAML; how finely the scan was computed, as JSON
/truth/geometry                          optional, like /entry/geometry: true poses, in the frame of the sample
/truth/paths                             optional: energy (n) [keV], data (V,n,R,K) float32, -log of the part of the
                                         photons of that energy that objects leave; bounds (i+1) [keV], nodes (i),
                                         error, depends_on
/nxtomo_<channel>                        the channel as NXtomo, virtual: flats, projections, darks
@digests                                 of the root, /entry, /truth and /nxtomo_<channel>: JSON, SHA-256 of each part
"""


def schema_text() -> str:
    """Format the table.

    Returns
    -------
    a line per array, then what is not checked array by array
    """
    lines = []
    for field in (*ENTRY, *TRUTH):
        shape = f"({field.shape.replace(' | ', ') or (')})" if field.kind != "text" or field.shape else ""
        words = [shape, field.units and f"[{field.units}]", field.values, "or NaN" if field.nan else ""]
        known = " ".join(word for word in words if word)
        lines.append(f"{field.path:<58} {known}; {field.about}{', optional' if field.optional else ''}\n")
    return "".join(lines) + _UNCHECKED


def form_problems(file: h5py.File, fields: tuple[Field, ...]) -> Iterator[str]:
    """Yield a sentence for each array that is missing, or whose type or shape is wrong.

    Parameters
    ----------
    file : open dataset
    fields : `ENTRY` or `TRUTH`

    Yields
    ------
    sentences
    """
    sizes: dict[str, int] = {}
    for field in fields:
        for path in _paths(file, field.path):
            array = find_array(file, path)
            if array is None:
                if not field.optional:
                    yield f"{file.filename} lacks {path}"
                continue
            with readable(file, path):
                shape, right = array.shape, _has_kind(array.dtype, field.kind)
            if not right:
                yield f"{file.filename}: {path} holds {array.dtype}, expected {field.values}"
            elif not _fits(shape, field.shape, sizes):
                yield f"{file.filename}: {path} has shape {shape}, expected {_expected(field.shape, sizes)}"


def value_problems(file: h5py.File, fields: tuple[Field, ...]) -> Iterator[str]:
    """Yield a sentence for each array with a value that cannot be; large arrays are left out.

    Parameters
    ----------
    file : open dataset, whose arrays have their types and shapes
    fields : `ENTRY` or `TRUTH`

    Yields
    ------
    sentences
    """
    for field in fields:
        if field.large:
            continue
        for path in _paths(file, field.path):
            if find_array(file, path) is None:
                continue
            values = np.asarray(value_at(file, path))
            if field.kind == "text":
                continue
            numbers = values.astype(np.float64)
            wrong = ~((numbers >= field.low) & (numbers <= field.high))
            wrong &= ~(np.isnan(numbers) & field.nan)
            if wrong.any():
                yield f"{file.filename}: {path} holds {numbers[wrong].flat[0]:g}, expected {field.values}"


def _paths(file: h5py.File, path: str) -> list[str]:
    """A path with all names that stand in it."""
    if "<channel>" in path:
        names = value_at(file, "/entry/data/channel")
        return [path.replace("<channel>", str(name)) for name in np.ravel(names).tolist()]
    if "<scheme>" in path:
        group = find_group(file, "/entry/splits")
        return [] if group is None else [path.replace("<scheme>", name) for name in names_in(group)]
    return [path]


def _has_kind(dtype: Any, kind: str) -> bool:
    """Whether values of a type are of a kind."""
    if kind == "text":
        return dtype.kind == "S" or h5py.check_string_dtype(dtype) is not None
    return dtype.kind in ("iu" if kind == "whole" else "iuf")


def _fits(shape: tuple[int, ...] | None, wanted: str, sizes: dict[str, int]) -> bool:
    """Whether a shape is one of those that are allowed; sizes that are not known yet become known."""
    if shape is None:
        return False
    for text in wanted.split(" | "):
        axes = [axis for axis in text.split(",") if axis]
        known = [_size(axis, sizes) for axis in axes]
        if len(shape) == len(axes) and all(size in (None, found) for size, found in zip(known, shape, strict=True)):
            sizes.update({axis: found for axis, found in zip(axes, shape, strict=True) if axis.isalpha()})
            return True
    return False


def _size(axis: str, sizes: dict[str, int]) -> int | None:
    """Size of an axis; None where it is not known."""
    if axis.isdigit():
        return int(axis)
    name, _, more = axis.partition("+")
    return sizes[name] + int(more or 0) if name in sizes else None


def _expected(wanted: str, sizes: dict[str, int]) -> str:
    """Shapes that are allowed, with the sizes that are known."""
    found = []
    for text in wanted.split(" | "):
        axes = [axis for axis in text.split(",") if axis]
        words = ", ".join("any" if a == "*" else str(s) if (s := _size(a, sizes)) is not None else a for a in axes)
        found.append(f"({words})")
    return " or ".join(found)
