"""Writing a dataset: beside its final name first, renamed when complete, removed when not.

What takes long is computed before, and kept by `phantomgen.dataset.writing.frame_journal`.
"""

import json
import os
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from jaxtyping import Float, Int, UInt32

from phantomgen.dataset.beam_profile import write_profile
from phantomgen.dataset.checks.digest import seal
from phantomgen.dataset.checks.door import array_at, group_at
from phantomgen.dataset.compression import Compression
from phantomgen.dataset.file import CUMULATIVE, DATASET
from phantomgen.dataset.geometry import write_geometry
from phantomgen.dataset.layout import SCHEMA, SCHEMA_VERSION, new_frames, new_group, put, put_note
from phantomgen.dataset.pixel_mask import write_mask
from phantomgen.dataset.spectral_model import Spectra
from phantomgen.dataset.time.view_times import ViewTimes, write_view_times
from phantomgen.dataset.true_poses import write_true_geometry
from phantomgen.dataset.truth import StreamedTruth, Truth, truth_group, write_grid, write_truth
from phantomgen.dataset.writing.nxtomo import write_aliases
from phantomgen.geometry.poses import Geometry, distances
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.runtime.disk import is_full, one_sentence, reserve
from phantomgen.runtime.output_lock import acquire
from phantomgen.runtime.outputs import check_output
from phantomgen.runtime.versions import environment, program_version
from spectra.errors import InputError
from spectra.materials.material import Material

SUFFIXES = (".h5", ".hdf5", ".nxs")  # of datasets
Splits = dict[str, Int[np.ndarray, " _view"]]


class DatasetWriter:
    """Writer of a dataset; use it in a ``with`` statement.

    Parameters
    ----------
    path : final name; ``<path>.part`` until complete
    overwrite : replace a file that exists
    compression : of all large arrays
    """

    def __init__(self, path: Path | str, overwrite: bool = False, compression: Compression = "gzip") -> None:
        self.path = Path(path)
        self.compression: Compression = compression
        self.part = self.path.with_name(self.path.name + ".part")
        check_output(self.path, overwrite, kind=DATASET)

    @property
    def reserved(self) -> Path:
        """File that takes some room on the disk while the dataset is written."""
        return self.part.with_name(self.part.name + ".room")

    def __enter__(self) -> "DatasetWriter":
        with one_sentence(self.part):
            self._lock = acquire(self.path)
            try:
                reserve(self.reserved)
                self.file = self._opened()
            except (OSError, RuntimeError) as error:
                if is_full(error):
                    self._discard()
                self._lock.unlink(missing_ok=True)
                raise
        return self

    def _opened(self) -> h5py.File:
        """Open the file that is written; an empty one here."""
        file = h5py.File(self.part, "w")
        _write_root(file)
        return file

    def __exit__(self, kind: type | None, error: BaseException | None, *trace: object) -> None:
        with one_sentence(self.part):
            try:
                if error is not None and is_full(error):
                    raise error
                if error is None:
                    self.reserved.unlink(missing_ok=True)
                    self.file.close()
                    os.replace(self.part, self.path)
            finally:
                self._discard()
                self._lock.unlink(missing_ok=True)

    def _discard(self) -> None:
        """Close and remove what is not complete.

        On a full disk HDF5 fails to close a file, keeps it open, and may crash; so it gets some room that was reserved.
        """
        self.reserved.unlink(missing_ok=True)
        with suppress(OSError, RuntimeError, AttributeError):
            self.file.close()
        if self.part.exists():
            os.truncate(self.part, 0)
            self.part.unlink()

    def write_scan(
        self,
        title: str,
        geometry: Geometry,
        spectra: Spectra,
        grid: Grid,
        splits: Splits,
        scheme: str,
        exposure: Float[np.ndarray, " view"] | Float[np.ndarray, "view channel"] | None = None,
    ) -> None:
        """Write everything about the scan except its counts.

        Parameters
        ----------
        title : name of the scan
        geometry : nominal poses
        spectra : the spectral model
        grid : voxels of the volume to reconstruct
        splits : indices of the views of each split
        scheme : name of the split
        exposure : of each view [and channel]; 1 for all where left out
        """
        entry = new_group(self.file, "entry", "NXentry", default="data")
        put(entry, "title", title)
        entry["start_time"] = h5py.SoftLink("/entry/process_1_simulate/date")
        write_geometry(entry, geometry)
        _write_sample(entry, geometry, title)
        _write_spectra(entry, spectra)
        put(
            new_group(entry, "exposure", "NXcollection"),
            "scale",
            np.ones(len(geometry)) if exposure is None else exposure,
        )
        group = new_group(entry, "splits", "NXcollection", default=scheme)
        for name, views in splits.items():
            put(group.require_group(scheme), name, np.asarray(views, dtype=np.int32))
        group[scheme].attrs["NX_class"] = "NXcollection"
        write_grid(new_group(entry, "reconstruction_grid", "NXcollection"), grid)

    def write_instrument(self, geometry: Geometry, spectra: Spectra, source: dict[str, tuple[Any, str | None]]) -> None:
        """Write detector and source.

        Parameters
        ----------
        geometry, spectra : of the scan
        source : further fields of NXsource as (value, unit)
        """
        instrument = new_group(group_at(self.file, "entry"), "instrument", "NXinstrument")
        detector = new_group(instrument, "detector", "NXdetector")
        put(detector, "x_pixel_size", geometry.panel.column_pitch, "mm")
        put(detector, "y_pixel_size", geometry.panel.row_pitch, "mm")
        put(detector, "distance", distances(geometry)["object_to_panel_mm"], "mm")
        if spectra.dead_time is not None:
            put(detector, "dead_time", spectra.dead_time.tau_ns, "ns")
            put(detector, "count_time", spectra.dead_time.exposure_ms, "ms")
            put(detector, "dead_time_model", spectra.dead_time.model)
        if spectra.pulses is not None:
            put(detector, "pulse_edges", spectra.pulses.edges, "keV")
            put(detector, "pulse_response", spectra.pulses.response, "")
        if spectra.cumulative:
            put(detector, "counters", CUMULATIVE)
        for name, lower, upper in zip(spectra.channels, spectra.lower, spectra.upper, strict=True):
            channel = new_group(detector, f"{name}_channel", "NXdetector_channel")
            put(channel, "threshold_energy", float(lower), "keV")
            put(channel, "upper_energy", float(upper), "keV")
        group = new_group(instrument, "source", "NXsource")
        for name, (value, units) in {"probe": ("x-ray", None), **source}.items():
            put(group, name, value, units)

    def write_mask(self, channels: tuple[str, ...], mask: UInt32[np.ndarray, "row column"] | None) -> None:
        """Write the pixels that do not measure; nothing where there is no mask.

        Parameters
        ----------
        channels : names of the channels
        mask : bits of each pixel; None for no mask
        """
        write_mask(self.file, channels, mask)

    def new_counts(
        self, shape: tuple[int, int, int, int], flats: int, darks: int, noise: bool, units: str = "counts"
    ) -> dict[str, h5py.Dataset]:
        """Create empty arrays ``data``, ``flat`` and ``dark``, to be filled by `write_image`.

        Parameters
        ----------
        shape : views, channels, rows, columns
        flats, darks : number of open-beam frames and of frames without beam
        noise : whether counts have noise
        units : unit of the values

        Returns
        -------
        arrays by name
        """
        dtype = np.int32 if noise and units == "counts" else np.float32
        instrument = group_at(self.file, "entry/instrument")
        how = (dtype, units, self.compression)
        data = new_frames(group_at(instrument, "detector"), "data", shape, *how)
        flat = new_frames(new_group(instrument, "flat", "NXdetector"), "data", (flats, *shape[1:]), *how)
        dark = new_frames(new_group(instrument, "dark", "NXdetector"), "data", (darks, *shape[1:]), *how)
        return {"data": data, "flat": flat, "dark": dark}

    def new_expected(self, shape: tuple[int, int, int, int], units: str = "counts") -> h5py.Dataset:
        """Create an empty array for the counts without noise, in the truth.

        Parameters
        ----------
        shape : views, channels, rows, columns
        units : unit of the values

        Returns
        -------
        the array
        """
        return new_frames(truth_group(self.file), "expected", shape, np.float32, units, self.compression)

    def write_truth(self, truth: Truth | StreamedTruth, materials: tuple[Material, ...]) -> None:
        """Write the truth.

        Parameters
        ----------
        truth : the truth, whole or in slabs
        materials : the materials
        """
        write_truth(self.file, truth, materials, self.compression)

    def write_time(self, times: ViewTimes, signals: Mapping[str, Float[np.ndarray, " view"]]) -> None:
        """Write the times of the views, and the signals that drove the objects.

        Parameters
        ----------
        times : of the views
        signals : value at each view, by name
        """
        from phantomgen.dataset.time.true_phases import write_signals  # noqa: PLC0415 - only where something moves

        write_view_times(group_at(self.file, "entry"), times)
        write_signals(truth_group(self.file), signals)

    def write_plan(self, text: str) -> None:
        """Write the plan of the simulation and its errors as JSON.

        Parameters
        ----------
        text : the JSON
        """
        put_note(truth_group(self.file), "plan", text, "application/json")

    def write_true_geometry(self, geometry: Geometry, sample: Float[np.ndarray, "view 4 4"] | None) -> None:
        """Write true poses beside the nominal ones, and those of a sample that moved.

        Parameters
        ----------
        geometry : true poses
        sample : matrices of the sample's poses [mm]; None where it did not move
        """
        write_true_geometry(truth_group(self.file), geometry, sample)

    def write_process(self, command: str, seed: int) -> None:
        """Write how the file was made; nothing about the object.

        Parameters
        ----------
        command : the command
        seed : of the noise
        """
        self._write_program("process_1_simulate", 1, command, seed)

    def write_step(
        self, what: str, number: int, seed: int, done: Sequence[str], settings: str, program: str = "phantomgen"
    ) -> None:
        """Write one more step of the history of the file, or its first one where it was not simulated.

        Parameters
        ----------
        what : command, which becomes a part of the name
        number : place in the history, counted from 1
        seed : of the random numbers
        done : what was done, one phrase each
        settings : all settings as JSON
        program : that has the command
        """
        process = self._write_program(f"process_{number}_{what}", number, f"{program} {what}", seed)
        if number == 1:
            entry = group_at(self.file, "entry")
            del entry["start_time"]
            entry["start_time"] = h5py.SoftLink(f"{process.name}/date")
        put(process, "done", np.array(done, dtype=object))
        put_note(process, "settings", settings, "application/json")

    def _write_program(self, name: str, number: int, command: str, seed: int) -> h5py.Group:
        """Write program, version, date and environment of a step."""
        process = new_group(group_at(self.file, "entry"), name, "NXprocess")
        put(process, "program", command.split(maxsplit=1)[0])
        put(process, "version", program_version())
        put(process, "date", _date())
        put(process, "sequence_index", number)
        put(process, "command", command)
        put(process, "seed", np.uint64(seed))
        put_note(process, "environment", json.dumps(environment(), indent=1), "application/json")
        return process

    def finish(self, spectra: Spectra) -> None:
        """Add the default plot, the aliases that other programs read, and the digests of all that was written.

        Parameters
        ----------
        spectra : the spectral model
        """
        data = new_group(
            group_at(self.file, "entry"), "data", "NXdata", signal="data", axes=("view", "channel", ".", ".")
        )
        data.attrs["default_slice"] = [".", spectra.channels[0], ".", "."]
        data["data"] = h5py.SoftLink("/entry/instrument/detector/data")
        put(data, "view", np.arange(array_at(self.file, "entry/instrument/detector/data").shape[0], dtype=np.int32))
        put(data, "channel", np.array(spectra.channels, dtype=object))
        write_aliases(self.file, spectra)
        seal(self.file)


def check_dataset_name(path: Path) -> None:
    """Refuse a name that would hide that a dataset is HDF5, before any work is done.

    Parameters
    ----------
    path : name of the dataset

    Raises
    ------
    InputError
        When the name does not end as those of HDF5 files do.
    """
    if path.suffix.lower() in SUFFIXES or path.is_dir():
        return
    volume = next((end for end in (".nii.gz", ".nii", ".vti") if path.name.lower().endswith(end)), "")
    right = path.with_name(f"{path.name[: len(path.name) - len(volume)]}.h5")
    hint = f"{right}, from which `phantomgen export {right} -o {path}` writes volumes" if volume else f"{right}"
    raise InputError(f"the output {path} is an HDF5 file, whose name ends in {', '.join(SUFFIXES)}: write {hint}")


def _write_root(file: h5py.File) -> None:
    """Root attributes."""
    file.attrs.update(
        {
            "NX_class": "NXroot",
            "default": "entry",
            "creator": "phantomgen",
            "creator_version": program_version(),
            "schema": SCHEMA,
            "schema_version": ".".join(map(str, SCHEMA_VERSION)),
            "HDF5_Version": h5py.version.hdf5_version,
            "h5py_version": h5py.version.version,
        }
    )


def _write_sample(entry: h5py.Group, geometry: Geometry, title: str) -> None:
    """Rotation of the sample: the source at angle a is the sample at -a."""
    sample = new_group(entry, "sample", "NXsample")
    put(sample, "name", title)
    put(sample, "rotation_angle", 0.0 - np.rad2deg(geometry.angles), "degree")


def _write_spectra(entry: h5py.Group, spectra: Spectra) -> None:
    """Energy grid, source, response and basis."""
    group = new_group(entry, "spectra", "NXdata", signal="channel", axes=(".", "energy"))
    put(group, "energy", spectra.energy, "keV")
    put(group, "energy_edges", spectra.edges, "keV")
    put(group, "source", spectra.source, "photons")
    put(group, "response", spectra.response, "1" if spectra.variance is None else spectra.units)
    put(group, "channel", spectra.weights, spectra.units)
    if spectra.variance is not None:
        put(group, "variance", spectra.variance, f"{spectra.units}^2")
    put(group, "basis", spectra.basis_values, "1")
    energies = {"edge_energy", "edge_width", "normalisation_energy", "reference_energy"}
    for name, value in spectra.basis.to_dict().items():
        put(
            group,
            name,
            np.array(value, dtype=object) if isinstance(value, list) else value,
            "keV" if name in energies else None,
        )
    if spectra.profile is not None:
        write_profile(group, spectra.profile)


def _date() -> str:
    """Time of writing in UTC, or that of ``SOURCE_DATE_EPOCH``, so that a file can be made again byte by byte."""
    seconds = os.environ.get("SOURCE_DATE_EPOCH", "")
    return time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(int(seconds) if seconds.isdigit() else None))
