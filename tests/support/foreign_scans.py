"""Scans of a ball in formats of others, written by what their documents say and not by our exporters.

Projections are closed forms, in each format's own frame, so that a wrong sign of an angle or an order shows.
"""

import json
import pickle
from pathlib import Path

import h5py
import numpy as np
import tifffile

ROWS, COLUMNS, VIEWS = 16, 20, 12
SOD, SDD, PITCH = 200.0, 300.0, 2.5
# The ball: centre in the frame of the volume (x, y, z) [mm], radius [mm], attenuation [1/mm].
CENTER, RADIUS, MU = np.array([4.0, -3.0, 2.0]), 5.0, 0.05
WHITE, DARK = 40000.0, 100.0


def chord(origin: np.ndarray, direction: np.ndarray, center: np.ndarray = CENTER) -> np.ndarray:
    """Line integrals through the ball along rays (..., 3)."""
    unit = direction / np.linalg.norm(direction, axis=-1, keepdims=True)
    along = np.einsum("...i,...i->...", center - origin, unit)
    square = np.sum((center - origin) ** 2, axis=-1) - along**2
    return 2 * MU * np.sqrt(np.maximum(RADIUS**2 - square, 0.0))


def view(
    angle: float, panel_u: float = 0.0, source_u: float = 0.0, parallel: bool = False, z: float = 0.0
) -> np.ndarray:
    """Line integrals (row, column) with the source at an angle [degree], columns counting that way, rows downwards."""
    a = np.deg2rad(angle)
    radial, tangent = np.array([np.cos(a), np.sin(a), 0.0]), np.array([-np.sin(a), np.cos(a), 0.0])
    u = (np.arange(COLUMNS) - (COLUMNS - 1) / 2) * PITCH + panel_u
    v = -(np.arange(ROWS) - (ROWS - 1) / 2) * PITCH
    pixel = (SOD - SDD) * radial + u[None, :, None] * tangent + (v[:, None, None] + z) * np.array([0.0, 0.0, 1.0])
    source = SOD * radial + source_u * tangent + np.array([0.0, 0.0, z])
    return chord(pixel, np.broadcast_to(-radial, pixel.shape)) if parallel else chord(source, pixel - source)


def readings(integrals: np.ndarray) -> np.ndarray:
    """Integers of a camera."""
    return np.rint(WHITE * np.exp(-integrals)).astype(np.uint16)


def write_nikon(folder: Path, keys: str = "") -> Path:
    """Nikon: columns from right to left, first view from +y; CIL's angle is 180 - i step - first."""
    path = folder / "ball.xtekct"
    lines = f"""[XTekCT]
Name=ball
InputSeparator=_
InputFolderName=
SrcToObject={SOD}
SrcToDetector={SDD}
DetectorPixelsX={COLUMNS}
DetectorPixelsY={ROWS}
DetectorPixelSizeX={PITCH}
DetectorPixelSizeY={PITCH}
WhiteLevel={WHITE}
Projections={VIEWS}
InitialAngle=10
AngularStep={360 / VIEWS}
{keys}
[CTPro]
Filter_ThicknessMM=0.5
Filter_Material=Copper
[Xrays]
XraykV=120
"""
    path.write_text(lines.replace("\n", "\r\n"))
    for i in range(VIEWS):
        image = nikon_view(-(i * 360 / VIEWS) - 10 + 180)
        tifffile.imwrite(folder / f"ball_{i + 1:04d}.tif", readings(image))
    return path


def nikon_view(theta: float) -> np.ndarray:
    """Line integrals in CIL's frame, whose sample turns by theta [degree] in front of a source at -y."""
    t = np.deg2rad(theta)
    x, y, z = CENTER
    # The volume's frame has the source on +x at our angle 0; CIL's has it on -y at its own 0, and shares x, y and z.
    turned = np.array([np.cos(t) * x - np.sin(t) * y, np.sin(t) * x + np.cos(t) * y, z])
    across = -(np.arange(COLUMNS) - (COLUMNS - 1) / 2) * PITCH  # top right
    up = -(np.arange(ROWS) - (ROWS - 1) / 2) * PITCH
    pixel = np.stack(np.broadcast_arrays(across[None], SDD - SOD, up[:, None]), axis=-1)
    source = np.array([0.0, -SOD, 0.0])
    return chord(source, pixel - source, turned)


def write_fips(folder: Path) -> Path:
    """FIPS and Helsinki: settings as text, one TIFF per view, angles of the source."""
    (folder / "pine.txt").write_text(
        f"ProjectName=pine\nScanner=cubic\nGeometryType=cone-beam\nDistanceSourceDetector={SDD}\n"
        f"DistanceSourceOrigin={SOD}\nNumberImages={VIEWS}\nAngleFirst=0\nAngleInterval={360 / VIEWS}\n"
        f"AngleLast={360 - 360 / VIEWS}\nDetectorType=CMOS\nPixelSize={PITCH}\nVoltage=50\nXRayFilter=Cu\n"
        "XRayFilterThickness=0.5\n"
    )
    for i in range(VIEWS):
        tifffile.imwrite(folder / f"pine_{i + 1:04d}.tif", readings(view(i * 360 / VIEWS)))
    return folder / "pine.txt"


def write_bruker(folder: Path, direction: str = "CC") -> Path:
    """SkyScan: the sample turns counter-clockwise (CC), so that the source turns the other way."""
    (folder / "bone.log").write_text(
        f"[System]\nScanner=SkyScan\nCamera Pixel Size (um)= 50.0\n[Acquisition]\nFilename Prefix=bone\n"
        f"Number of Files= {VIEWS}\nSource Voltage (kV)= 70\nNumber of Rows= {ROWS}\nNumber of Columns= {COLUMNS}\n"
        f"Image Pixel Size (um)={PITCH * SOD / SDD * 1000}\nObject to Source (mm)={SOD}\nCamera to Source (mm)={SDD}\n"
        f"Filter=Al 0.5mm\nDepth (bits)=16\nRotation Step (deg)={360 / VIEWS}\nRotation Direction={direction}\n"
    )
    sense = -1 if direction == "CC" else 1
    for i in range(VIEWS):
        image = np.rint(65535 * np.exp(-view(sense * i * 360 / VIEWS))).astype(np.uint16)
        tifffile.imwrite(folder / f"bone{i:04d}.tif", image)
    return folder / "bone.log"


def write_dxchange(folder: Path, name: str = "exchange.h5") -> Path:
    """Data Exchange: a parallel beam, angles of the sample in degrees, white and dark frames."""
    angles = np.arange(VIEWS) * 180 / VIEWS
    with h5py.File(folder / name, "w") as file:
        file["implements"] = "exchange"
        group = file.create_group("exchange")
        group["data"] = np.stack([readings(view(-a, parallel=True)) + np.uint16(DARK) for a in angles])
        group["data_white"] = np.full((2, ROWS, COLUMNS), WHITE + DARK, np.uint16)
        group["data_dark"] = np.full((1, ROWS, COLUMNS), DARK, np.uint16)
        group["theta"] = angles
        file["measurement/instrument/detector/pixel_size_x"] = PITCH * 1000
        file["measurement/instrument/detector/pixel_size_y"] = PITCH * 1000
        for axis in "xy":
            file[f"measurement/instrument/detector/pixel_size_{axis}"].attrs["units"] = "microns"
        file["measurement/instrument/monochromator/energy"] = 60.0
    return folder / name


def write_nxtomo(folder: Path, lift: float = 0.0) -> Path:
    """NXtomo by the package of ESRF: sample angles, lengths with units, flats and darks by key."""
    import pint
    from nxtomo.application.nxtomo import NXtomo

    unit = pint.get_application_registry()
    angles = np.arange(VIEWS) * 360 / VIEWS
    heights = np.linspace(-lift / 2, lift / 2, VIEWS)
    images = [readings(view(-a, z=-h)) + np.uint16(DARK) for a, h in zip(angles, heights, strict=True)]
    flat, dark = np.full((ROWS, COLUMNS), WHITE + DARK, np.uint16), np.full((ROWS, COLUMNS), DARK, np.uint16)
    scan = NXtomo()
    scan.title = "ball"
    scan.instrument.detector.data = np.stack([dark, flat, *images, flat])
    scan.instrument.detector.image_key_control = [2, 1, *[0] * VIEWS, 1]
    scan.instrument.detector.x_pixel_size = scan.instrument.detector.y_pixel_size = PITCH * unit.millimeter
    scan.instrument.detector.distance = (SDD - SOD) * unit.millimeter
    scan.instrument.source.distance = -SOD * unit.millimeter
    scan.sample.rotation_angle = np.array([0.0, 0.0, *angles, 0.0]) * unit.degree
    if lift:
        scan.sample.z_translation = np.array([0.0, 0.0, *heights, 0.0]) * unit.millimeter
    path = folder / "ball.nx"
    scan.save(str(path), "entry0000")
    return path


def write_r2(folder: Path, name: str = "ball") -> Path:
    """R2-Gaussian: JSON in radians, pairs (v, u), lengths in units of its own."""
    path = folder / name
    (path / "proj_train").mkdir(parents=True)
    (path / "proj_test").mkdir()
    lists: dict[str, list] = {"proj_train": [], "proj_test": []}
    for i in range(VIEWS):
        part = "proj_test" if i % 4 == 3 else "proj_train"
        file = f"{part}/{i:04d}.npy"
        np.save(path / file, view(i * 360 / VIEWS).astype(np.float32))
        lists[part].append({"file_path": file, "angle": float(np.deg2rad(i * 360 / VIEWS))})
    scanner = {
        "mode": "cone", "DSD": SDD, "DSO": SOD, "nDetector": [ROWS, COLUMNS],
        "sDetector": [ROWS * PITCH, COLUMNS * PITCH], "nVoxel": [12, 12, 10], "sVoxel": [30.0, 30.0, 25.0],
        "offOrigin": [0, 0, 0], "offDetector": [0, 0],
    }  # fmt: skip
    (path / "meta_data.json").write_text(json.dumps({"scanner": scanner, **lists}))
    return path


def write_naf(folder: Path, name: str = "ball.pickle") -> Path:
    """NAF: a pickle of arrays; square panels only, so that the middle of the ball's views is padded to one."""
    square, angles = max(ROWS, COLUMNS), np.deg2rad(np.arange(VIEWS) * 360 / VIEWS)
    images = np.zeros((VIEWS, square, square), np.float32)
    first = (square - ROWS) // 2
    for i, a in enumerate(angles):
        images[i, first : first + ROWS] = view(float(np.rad2deg(a)))
    content = {
        "DSD": SDD, "DSO": SOD, "nDetector": [square, square], "dDetector": [PITCH, PITCH], "nVoxel": [12, 12, 12],
        "dVoxel": [2.5, 2.5, 2.5], "offOrigin": [0, 0, 0], "offDetector": [0, 0], "mode": "cone",
        "train": {"projections": images[:9], "angles": angles[:9]},
        "val": {"projections": images[9:], "angles": angles[9:]},
    }  # fmt: skip
    (folder / name).write_bytes(pickle.dumps(content))
    return folder / name


def write_tiff(folder: Path) -> Path:
    """TIFF files with a YAML file, two channels that see the same."""
    for channel in ("low", "high"):
        place = folder / channel
        place.mkdir()
        for i in range(VIEWS):
            tifffile.imwrite(place / f"view_{i:03d}.tif", readings(view(i * 360 / VIEWS)) + np.uint16(DARK))
        tifffile.imwrite(place / "flat.tif", np.full((2, ROWS, COLUMNS), WHITE + DARK, np.uint16))
        tifffile.imwrite(place / "dark.tif", np.full((ROWS, COLUMNS), DARK, np.uint16))
    path = folder / "scan.yaml"
    path.write_text(
        f"geometry: {{type: circular, sod: {SOD}, sdd: {SDD}, views: {VIEWS}}}\n"
        f"panel: {{rows: {ROWS}, columns: {COLUMNS}, pitch: {PITCH}}}\n"
        'values: counts\nchannels: [low, high]\nviews: "{channel}/view_*.tif"\nflats: "{channel}/flat.tif"\n'
        'darks: "{channel}/dark.tif"\nbeam: {kvp: 120, filter: 2 mm Al, thresholds: [20, 60]}\n'
    )
    return path


def write_dicom(folder: Path, shape: str = "CYLINDRICAL", transposed: bool = False) -> Path:
    """DICOM-CT-PD: a helix, log projections on a cylinder around the focal spot, or on a flat panel."""
    from pydicom import Dataset
    from pydicom.dataset import FileMetaDataset
    from pydicom.uid import ExplicitVRLittleEndian, generate_uid

    path = folder / "helix"
    path.mkdir()
    column0, row0 = COLUMNS / 2 + 0.25, (ROWS + 1) / 2  # counted from 1
    for i in range(VIEWS):
        phi, z = 2 * np.pi * i / VIEWS, 4.0 * (i / VIEWS - 0.5)
        ray = np.array([np.sin(phi), -np.cos(phi), 0.0])
        along, up = np.array([-np.cos(phi), -np.sin(phi), 0.0]), np.array([0.0, 0.0, 1.0])
        source = np.array([-SOD * np.sin(phi), SOD * np.cos(phi), z])
        across = (np.arange(1, COLUMNS + 1) - column0)[None, :, None] * PITCH
        down = (np.arange(1, ROWS + 1) - row0)[:, None, None] * PITCH
        if shape == "FLAT":
            direction = SDD * ray + across * along - down * up
        else:
            direction = SDD * (np.cos(across / SDD) * ray + np.sin(across / SDD) * along) - down * up
        image = chord(source, direction)
        data = Dataset()
        data.file_meta = FileMetaDataset()
        data.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
        data.SOPClassUID = data.file_meta.MediaStorageSOPClassUID = "1.2.840.10008.5.1.4.1.1.66"
        data.SOPInstanceUID = data.file_meta.MediaStorageSOPInstanceUID = generate_uid()
        data.InstanceNumber, data.KVP = i + 1, "120"
        for tag, kind, value in (
            (0x70291010, "US", ROWS), (0x70291011, "US", COLUMNS), (0x70291002, "FL", PITCH), (0x70291006, "FL", PITCH),
            (0x7029100B, "CS", shape), (0x70311001, "FL", phi), (0x70311002, "FL", z), (0x70311003, "FL", SOD),
            (0x70311031, "FL", SDD), (0x70311033, "FL", [column0, row0]), (0x70331065, "FL", [9e4] * COLUMNS),
        ):  # fmt: skip
            data.add_new(tag, kind, value)
        stored = image.T if transposed else image
        data.RescaleSlope, data.RescaleIntercept = "0.00001", "0"
        data.Rows, data.Columns, data.SamplesPerPixel = *stored.shape, 1
        data.BitsAllocated = data.BitsStored = 16
        data.HighBit, data.PixelRepresentation, data.PhotometricInterpretation = 15, 0, "MONOCHROME2"
        data.PixelData = np.rint(stored / 1e-5).astype("<u2").tobytes()
        data.save_as(path / f"{i:05d}.dcm", enforce_file_format=True)
    return path


def write_ctsimu(folder: Path) -> Path:
    """CTSimU: a stage beside the beam that leans and rises, seen in the world, and what must not be known of it."""
    name = "ball"

    def vector(*values: float, unit: str | None = None) -> dict:
        return {axis: {"value": value, "unit": unit} for axis, value in zip("xyz", values, strict=True)}

    def part(center: dict, u: dict, w: dict, deviations: list) -> dict:
        return {"center": center, "vector_u": u, "vector_w": w, "deviations": deviations}

    across, along = vector(0, -1, 0), vector(1, 0, 0)
    stage = vector(SOD, 1.5, 0, unit="mm")
    stage["z"]["drifts"] = [{"value": [-0.3, 0.3], "unit": "cm"}, {"value": [0, 9], "known_to_reconstruction": False}]
    lean = {"type": "rotation", "axis": "x", "amount": {"value": 10, "unit": "deg"}}
    secret = {
        "type": "translation",
        "axis": "z",
        "amount": {"value": 7, "unit": "mm"},
        "known_to_reconstruction": False,
    }
    shift = {"type": "translation", "axis": "u", "amount": {"value": 2.5, "unit": "mm"}}
    scenario = {
        "file": {"name": name, "file_type": "CTSimU Scenario"},
        "geometry": {
            "source": {"type": "cone", **part(vector(0, 0, 0, unit="mm"), across, along, [])},
            "detector": part(vector(SDD / 10, 0, 0, unit="cm"), across, along, [shift]),
            "stage": part(stage, vector(1, 0, 0), vector(0, 0, 1), [lean, secret]),
        },
        "detector": {
            "columns": {"value": COLUMNS}, "rows": {"value": ROWS},
            "pixel_pitch": {axis: {"value": PITCH, "unit": "mm"} for axis in "uv"},
            "gray_value": {"imin": {"value": DARK}},
        },
        "source": {"voltage": {"value": 60, "unit": "kV"}, "spectrum": {"monochromatic": True, "file": None}},
        "acquisition": {
            "start_angle": {"value": 5, "unit": "deg"}, "stop_angle": {"value": 365, "unit": "deg"}, "direction": "CCW",
            "number_of_projections": VIEWS, "include_final_angle": False,
        },
    }  # fmt: skip
    (folder / f"{name}.json").write_text(json.dumps(scenario))
    metadata = {
        "file": {"file_type": "CTSimU Metadata"},
        "output": {
            "projections": {
                "filename": "ball_%04d.tif", "number": VIEWS, "max_intensity": WHITE + DARK, "datatype": "uint16",
                "headersize": {"file": 0, "image": 0}, "dark_field": {"number": 0}, "flat_field": {"number": 0},
            }
        },
        "acquisition_geometry": {"path_to_CTSimU_JSON": f"{name}.json"},
    }  # fmt: skip
    (folder / f"{name}_metadata.json").write_text(json.dumps(metadata))
    ten = np.deg2rad(10)
    tilt = np.array([[1, 0, 0], [0, np.cos(ten), -np.sin(ten)], [0, np.sin(ten), np.cos(ten)]])
    for i in range(VIEWS):
        a = np.deg2rad(5 + 360 * i / VIEWS)
        spin = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
        ball = np.array([SOD, 1.5, -3 + 6 * i / (VIEWS - 1)]) + tilt @ spin @ CENTER
        y = -2.5 - (np.arange(COLUMNS) - (COLUMNS - 1) / 2) * PITCH
        z = -(np.arange(ROWS) - (ROWS - 1) / 2) * PITCH
        pixel = np.stack(np.broadcast_arrays(SDD, y[None], z[:, None]), axis=-1)
        tifffile.imwrite(folder / f"ball_{i:04d}.tif", readings(chord(np.zeros(3), pixel, ball)) + np.uint16(DARK))
    return folder / f"{name}_metadata.json"


# Format: function that writes it, and options that state what it does not.
KEV = ("--energy", "60")
COUNTER = (*KEV, "--thresholds", "20")
FORMATS = {
    "tiff": (write_tiff, ()),
    "nxtomo": (write_nxtomo, COUNTER),
    "dxchange": (write_dxchange, ("--thresholds", "20")),
    "nikon": (write_nikon, (*KEV, "--photons", "2e4")),
    "fips": (write_fips, (*KEV, "--photons", "2e4", "--white", str(WHITE))),
    "bruker": (write_bruker, (*KEV, "--photons", "2e4")),
    "r2": (write_r2, (*COUNTER, "--photons", "2e4")),
    "naf": (write_naf, (*COUNTER, "--photons", "2e4")),
    "ctsimu": (write_ctsimu, ("--photons", "2e4")),
    "dicom-ct-pd": (write_dicom, (*KEV, "--photons", "2e4")),
}
