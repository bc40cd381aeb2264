"""Datasets, runs, meshes, images and tables whose bytes or arrays are spoiled are read, or refused in a sentence."""

import gzip
import io
import json
import shutil
import struct
from dataclasses import replace

import h5py
import numpy as np
import pytest
import tifffile
import trimesh
import yaml
from hypothesis import given
from hypothesis import strategies as st
from support.door import run, tries
from support.gaussian_scenes import small_model
from support.mutations import HOSTILE, spoiled_array, spoiled_bytes, spoiled_documents
from support.tiny_scans import make
from support.tiny_scenes import SCENE, TINY

from phantomgen.cli.main import main as phantomgen
from phantomgen.geometry.voxel_grid import Grid
from recon.cli.main import main as recon
from recon.runs.run_folder import MODEL, write_scan
from spectra.basis.basis import Basis, BasisFunction
from spectra.transmission import Transmission

pytestmark = pytest.mark.filterwarnings("default")


def saved(array):
    """An array as the bytes of a .npy file."""
    memory = io.BytesIO()
    np.save(memory, array)
    return memory.getvalue()


def nifti(array):
    """An array as the bytes of a NIfTI-1 file with voxels of 2 mm, by the layout of its header of 348 bytes."""
    header = bytearray(352)
    struct.pack_into("<i", header, 0, 348)
    struct.pack_into("<8h", header, 40, 3, *array.shape, 1, 1, 1, 1)
    struct.pack_into("<2h", header, 70, 2, 8)  # unsigned bytes
    struct.pack_into("<8f", header, 76, 1, 2, 2, 2, 1, 1, 1, 1)
    struct.pack_into("<f", header, 108, 352)
    struct.pack_into("<f", header, 112, 1)
    header[123] = 2  # mm
    header[344:348] = b"n+1\0"
    return bytes(header) + array.tobytes(order="F")


def tiff(array):
    """An array as the bytes of a TIFF."""
    memory = io.BytesIO()
    tifffile.imwrite(memory, array)
    return memory.getvalue()


LABELS = np.zeros((4, 4, 4), np.uint8)
LABELS[1:3, 1:3, 1:3] = 1
IMAGES = {
    "npy": saved(LABELS),
    "nii": nifti(LABELS),
    "nii.gz": gzip.compress(nifti(LABELS), mtime=0),
    "tif": tiff(LABELS),
}
SOLID = trimesh.creation.box((10, 10, 10))
MESHES = {kind: SOLID.export(file_type=kind) for kind in ("stl", "ply", "obj", "glb")}
MESHES = {kind: content.encode() if isinstance(content, str) else content for kind, content in MESHES.items()}
MESHES["stl_ascii"] = SOLID.export(file_type="stl_ascii").encode()
RESPONSE = b"energy,10,40,70,100\n" + b"".join(b"%d,0.1,0.3,0.5,0.1\n" % energy for energy in range(10, 101, 10))
NAMES = [f"{name}_{axis}" for name in ("source", "panel_center", "column_step", "row_step") for axis in "xyz"]
POSES = (",".join(NAMES) + "\n" + "-500,0,0,300,0,0,0,40,0,0,0,40\n" * 3).encode()


@pytest.fixture(scope="module")
def samples(place):
    """A tiny scan and a run folder to spoil copies of."""
    make(place / "scan.h5", "--views", "3", "--test-views", "1", voxels=4, rows=4, columns=4)
    folder = place / "run"
    folder.mkdir()
    basis = Basis((BasisFunction("photoelectric"), BasisFunction("compton"), BasisFunction("step", edge_energy=63.3)))
    replace(small_model(1), basis_names=basis.names).save(folder / MODEL)
    transmission = Transmission.from_spectrum(
        np.eye(2).repeat(4, axis=1) * 1e3, basis.evaluate(np.linspace(30, 100, 8))
    )
    write_scan(folder, Grid((4, 4, 4), (8.0, 8.0, 8.0), (-12.0, -12.0, -12.0)), basis, transmission, ("low", "high"))
    with h5py.File(place / "scan.h5") as file:
        names = []
        file.visititems(lambda name, item: names.append(name) if isinstance(item, h5py.Dataset) else None)
    return place, sorted(name for name in names if not name.startswith("nxtomo"))


def scanned(place, solid, **changed):
    """Make a tiny scan of one solid."""
    scene = {**SCENE, "objects": [solid if solid["type"] == "voxels" else {"material": "water", **solid}], **changed}
    scene["effects"] = {}
    (place / "tiny.yaml").write_text(yaml.safe_dump(scene))
    result = run(phantomgen, "make", "tiny.yaml", "-q", "-o", "made.h5", "--overwrite", *TINY)
    if result.exit_code == 0:
        with h5py.File(place / "made.h5") as file:
            assert np.isfinite(file["entry/instrument/detector/data"][:]).all()


@tries(8)
@given(kind=st.sampled_from(sorted(MESHES)), data=st.data())
@pytest.mark.slow
def test_meshes(place, kind, data):
    name = f"part.{kind.removesuffix('_ascii')}"
    (place / name).write_bytes(data.draw(spoiled_bytes((MESHES[kind],))))
    scanned(place, {"type": "mesh", "file": name, "unit": "mm"})


@tries(8)
@given(kind=st.sampled_from(sorted(IMAGES)), data=st.data())
def test_images(place, kind, data):
    (place / f"map.{kind}").write_bytes(data.draw(spoiled_bytes((IMAGES[kind],))))
    spacing = {} if kind.startswith("nii") else {"spacing": 4.0}
    scanned(place, {"type": "voxels", "file": f"map.{kind}", "labels": {1: "water"}, **spacing})


@tries(5)
@given(content=spoiled_bytes((RESPONSE,)))
@pytest.mark.slow
def test_response_tables(place, content):
    (place / "response.csv").write_bytes(content)
    detector = {
        "type": "response_matrix",
        "file": "response.csv",
        "columns": "deposited",
        "per": "bin",
        "thresholds": [20, 45],
    }
    scanned(place, {"type": "sphere", "radius": 20}, detector=detector)


@tries(5)
@given(content=spoiled_bytes((POSES,)))
def test_pose_tables(place, content):
    (place / "poses.csv").write_bytes(content)
    scanned(place, {"type": "sphere", "radius": 20}, geometry={"type": "poses", "file": "poses.csv"})


@tries(6)
@given(data=st.data())
def test_datasets_with_spoiled_arrays(samples, data):
    place, names = samples
    shutil.copy(place / "scan.h5", place / "bad.h5")
    with h5py.File(place / "bad.h5", "r+") as file:
        name = data.draw(st.sampled_from(names))
        array = file[name][()]
        attributes = dict(file[name].attrs)
        action = data.draw(st.sampled_from(("array", "array", "array", "remove", "attribute", "group")))
        if action == "attribute":
            holder = file[data.draw(st.sampled_from(("/", "entry", "truth", name)))]
            if holder.attrs:
                value = data.draw(
                    st.sampled_from([v for v in HOSTILE if isinstance(v, int | float | str) and v != 10**30])
                )
                holder.attrs[data.draw(st.sampled_from(sorted(holder.attrs)))] = str(value).replace("\0", "")
        else:
            del file[name]
            if action == "array":
                spoiled = array if not isinstance(array, np.ndarray) else spoiled_array(data.draw, array)
                file[name] = spoiled
                file[name].attrs.update({key: value for key, value in attributes.items() if key != "checksum"})
            elif action == "group":
                file.create_group(name)
    run(phantomgen, "validate", "--seal", "bad.h5")
    run(phantomgen, "validate", "bad.h5")
    run(recon, "decompose", "bad.h5", "--to", "naf", "-o", "lines", "--overwrite")


@tries(10)
@given(data=st.data())
def test_datasets_with_spoiled_bytes(samples, data):
    place, _ = samples
    (place / "bad.h5").write_bytes(data.draw(spoiled_bytes(((place / "scan.h5").read_bytes(),))))
    run(phantomgen, "validate", "bad.h5")
    run(phantomgen, "info", "bad.h5")


@tries(10)
@given(data=st.data())
def test_run_folders(samples, data):
    place, _ = samples
    shutil.rmtree(place / "bad.run", ignore_errors=True)
    shutil.copytree(place / "run", place / "bad.run")
    if data.draw(st.booleans()):
        known = json.loads((place / "run" / "scan.json").read_text())
        spoiled = data.draw(spoiled_documents((known,)))
        (place / "bad.run" / "scan.json").write_text(json.dumps({str(key): value for key, value in spoiled.items()}))
    else:
        name = data.draw(st.sampled_from((MODEL, "scan.json")))
        (place / "bad.run" / name).write_bytes(data.draw(spoiled_bytes(((place / "run" / name).read_bytes(),))))
    result = run(recon, "volume", "bad.run", "--grid", "4", "-o", "volume.h5", "--overwrite")
    if result.exit_code == 0:
        with h5py.File(place / "volume.h5") as file:
            file.visititems(lambda name, item: finite(name, item) if isinstance(item, h5py.Dataset) else None)


def finite(name, item):
    """Fail where a volume holds what is no number."""
    if item.dtype.kind == "f":
        assert np.isfinite(item[()]).all(), name


@pytest.mark.slow
def test_samples_that_are_not_spoiled_are_read(samples):
    place, _ = samples
    shutil.rmtree(place / "bad.run", ignore_errors=True)
    assert run(recon, "volume", "run", "--grid", "4", "-o", "whole.h5").exit_code == 0
    assert run(phantomgen, "validate", "scan.h5").exit_code == 0
    (place / "map.npy").write_bytes(IMAGES["npy"])
    (place / "part.ply").write_bytes(MESHES["ply"])
    scanned(place, {"type": "mesh", "file": "part.ply", "unit": "mm"})
    scanned(place, {"type": "voxels", "file": "map.npy", "labels": {1: "water"}, "spacing": 4.0})
    assert (place / "made.h5").is_file()
