"""Layout of the HDF5 files of this project: version, names, and packing of images.

A dataset is a NeXus file. Measured data lie in ``/entry``, everything that knows the object in ``/truth``, and each
channel is shown once more, without copying, as an NXtomo entry ``/nxtomo_<channel>``.
"""

from hashlib import sha256
from typing import Any

import h5py
import numpy as np
from jaxtyping import Shaped

from phantomgen.dataset.checks.fletcher import fletcher32
from phantomgen.dataset.compression import Compression, filters, pack

SCHEMA = "spectral-ct"
SCHEMA_VERSION = (1, 1)
FRAME = "right-handed, z = rotation axis, origin = isocentre"
FRACTION_SCALE = 65535
# Most bytes of a chunk, uncompressed; rows of larger images are split.
_CHUNK_BYTES = 4 << 20

SCHEMA_TABLE = """\
/entry/instrument/detector/data          (V,C,R,K) int32 or float32   counts, or signal as `units` says
/entry/instrument/detector/x_pixel_size  () mm     pitch along columns; y_pixel_size along rows
/entry/instrument/detector/distance      () mm     sample to panel
/entry/instrument/detector/<n>_channel   threshold_energy, upper_energy [keV]; pixel_mask (R,K), optional: 0 for a
                                         pixel that measures, else bits of NXdetector: 1 dead, 3 hot, 6 in a cluster
/entry/instrument/detector/dead_time     () ns, optional, with count_time () [ms] and dead_time_model
/entry/instrument/flat/data              (F,C,R,K) open-beam frames
/entry/instrument/dark/data              (D,C,R,K) frames without beam
/entry/instrument/source                 probe, type, voltage [kV], charge per view [mA*s], target_material
/entry/sample                            name, rotation_angle (V) [degree]
/entry/geometry                          kind, source, panel_center, column_step, row_step (V,3) [mm]; in a parallel
                                         beam ray_direction (V,3), unit vectors, in place of source
/entry/spectra                           energy (E), energy_edges (E+1) [keV], source (E) [photons], response (C,E),
                                         channel (C,E), basis (M,E), basis_name, basis_kind, edge_energy, edge_width,
                                         element, normalisation_energy, reference_energy; for bases of materials
                                         basis_composition: elements and their amounts, such as H 0.11 O 0.89;
                                         variance (C,E), optional: of a signal per photon, where that is not the
                                         response
/entry/spectra/profile                   optional, for bowtie and heel effect: name (P), mu (P,E) [1/mm],
                                         thickness (P,R,K) [mm] beyond that at the panel's centre; the beam to a pixel
                                         is source x exp(-sum_p mu thickness)
/entry/exposure/scale                    (V) or (V,C) tube output per view [and channel]
/entry/splits/<scheme>                   train, test, val: indices of views; @default names the scheme
/entry/reconstruction_grid               shape, spacing, origin (z,y,x) [mm]; origin is the centre of voxel 0
/entry/process_<n>_<what>                program, version, date, sequence_index, command, seed, environment; of a later
                                         step than the first also done (phrases) and settings (JSON)
/truth/basis/data                        (M,z,y,x) float32 [1/mm]
/truth/fractions                         (material,z,y,x) uint16, 65535 = the whole voxel
/truth/labels                            (z,y,x) uint8 or uint16, 0 = background, i + 1 = material i
/truth/materials                         name, density [g/cm^3], composition, coefficients (material,M) [1/mm], kind:
                                         explicit or fitted, fit_error (rms, relative), fit_window [keV], fit_weights
/truth/grid                              shape, spacing, origin (z,y,x), affine (4,4) for (x,y,z) [mm]
/truth/scene                             the scene as YAML
/truth/plan                              how finely the scan was computed, and the error of each part, as JSON
/truth/geometry                          optional, like /entry/geometry: true poses, in the frame of the sample
/truth/motion/pose                       (V,4,4) [mm], optional: from the sample at rest, as in /truth, to where it was
/truth/expected                          (V,C,R,K) float32, optional: counts without noise
/truth/paths                             optional: energy (n) [keV], data (V,n,R,K) float32, -log of the part of the
                                         photons of that energy that objects leave; bounds (i+1) [keV], nodes (i),
                                         error, depends_on
/nxtomo_<channel>                        the channel as NXtomo, virtual: flats, projections, darks
"""


def text_of(value: Any) -> str:
    """Convert text from HDF5 to ``str``.

    Parameters
    ----------
    value : bytes or text

    Returns
    -------
    text
    """
    return value.decode() if isinstance(value, bytes) else str(value)


def put(group: h5py.Group, name: str, value: Any, units: str | None = None) -> h5py.Dataset:
    """Write a number, a text, or an array of either.

    Parameters
    ----------
    group : group that gets it
    name : name of the field
    value : the value
    units : unit; None for no attribute

    Returns
    -------
    the written field
    """
    array = np.asarray(value)
    if array.dtype.kind in "UO":
        dataset = group.create_dataset(name, data=array.astype(object), dtype=h5py.string_dtype())
    else:
        dataset = group.create_dataset(name, data=array)
    if units is not None:
        dataset.attrs["units"] = units
    return dataset


def new_group(parent: h5py.Group, name: str, nx_class: str, **attributes: Any) -> h5py.Group:
    """Create a NeXus group.

    Parameters
    ----------
    parent : group that gets it
    name : name of the group
    nx_class : its NeXus class
    **attributes : further attributes

    Returns
    -------
    the group
    """
    group = parent.create_group(name)
    group.attrs["NX_class"] = nx_class
    for key, value in attributes.items():
        group.attrs[key] = [*value] if isinstance(value, tuple) else value
    return group


def put_note(parent: h5py.Group, name: str, data: str, mime_type: str) -> None:
    """Write text as an NXnote with its checksum.

    Parameters
    ----------
    parent : group that gets it
    name : name of the note
    data : the text
    mime_type : type of the text
    """
    note = new_group(parent, name, "NXnote")
    put(note, "type", mime_type)
    put(note, "data", data)
    put(note, "checksum", sha256(data.encode()).hexdigest())
    put(note, "algorithm", "sha256")


def new_frames(
    group: h5py.Group,
    name: str,
    shape: tuple[int, ...],
    dtype: Any,
    units: str | None = None,
    compression: Compression = "gzip",
) -> h5py.Dataset:
    """Create an array of images (..., row, column), one image per chunk, compressed.

    Parameters
    ----------
    group : group that gets it
    name : name of the array
    shape : of the whole array
    dtype : of the values
    units : unit; None for no attribute
    compression : name of the compression

    Returns
    -------
    the empty array
    """
    rows = _rows_per_chunk(shape[-2], shape[-1] * np.dtype(dtype).itemsize)
    chunks = (*(1,) * (len(shape) - 2), rows, shape[-1]) if shape[0] else None
    dataset = group.create_dataset(name, shape, dtype, chunks=chunks, **(filters(compression) if chunks else {}))
    if units is not None:
        dataset.attrs["units"] = units
    return dataset


def pack_image(image: Shaped[np.ndarray, "row column"], compression: Compression = "gzip") -> list[bytes]:
    """Compress the chunks of one image as HDF5 stores them; unlike HDF5's own filters this runs in any thread.

    Parameters
    ----------
    image : values, (row, column)
    compression : name of the compression

    Returns
    -------
    bytes of each chunk
    """
    rows, columns = image.shape
    step = _rows_per_chunk(rows, columns * image.itemsize)
    padded = np.pad(image, ((0, -rows % step), (0, 0)))
    return [pack(padded[first : first + step], compression) for first in range(0, rows, step)]


def write_image(dataset: h5py.Dataset, frame: int, channel: int, packed: list[bytes]) -> None:
    """Write an image from `pack_image` at its place, each chunk with its checksum.

    Parameters
    ----------
    dataset : array of images
    frame, channel : indices of the image
    packed : bytes of each chunk
    """
    step = _rows_per_chunk(dataset.shape[-2], dataset.shape[-1] * dataset.dtype.itemsize)
    for i, chunk in enumerate(packed):
        dataset.id.write_direct_chunk((frame, channel, i * step, 0), chunk + fletcher32(chunk))


def _rows_per_chunk(rows: int, row_bytes: int) -> int:
    """Rows that fit a chunk."""
    return min(rows, max(1, _CHUNK_BYTES // row_bytes))
