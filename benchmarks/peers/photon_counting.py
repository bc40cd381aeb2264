"""A photon-counting scan beside gecatsim's (XCIST): counts per bin behind cylinders, and the response of the sensor.

Needs gecatsim 1.6.9 (on Linux, convert the line ends of `gecatsim/clib_build/*` of its source archive before
`pip install`). Run: python -m benchmarks.peers.photon_counting

**Chain.** Both programs scan the same cylinders with the same spectrum, 3 mm of aluminium, the same arc of columns and
the same response matrix, gecatsim's for pixels of 0.25 mm in 1.6 mm of CZT. What differs is attenuation, the energies
at which spectra are sampled (gecatsim: every keV), and the tracing of rays. Rows give the differences of log
projections of the rays that pass through the middle seven tenths of a cylinder, and those of the attenuation
coefficients alone.

**Sensor.** Counts above a threshold per absorbed photon, by gecatsim's matrix and by `spectra.PulseHeightDetector`,
whose energy resolution and charge cloud are fitted to all of them, as the matrix states neither.
"""

import os
import subprocess
import sys
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import yaml
from scipy.io import loadmat
from scipy.optimize import minimize

import phantomgen
import spectra

SOD, SDD, COLUMNS = 540.0, 950.0, 400
THRESHOLDS = (20.0, 35.0, 50.0, 65.0, 80.0)  # keV
MATRIX = "PC_spectral_response_CZT0.25x0.25x1.6.mat"
SPECTRUM = "tungsten_tar7.0_120_filt.dat"
CZT = spectra.Material("CZT", 5.78, {"Cd": 0.429953, "Zn": 0.027785, "Te": 0.542262})  # of gecatsim's file
SENSOR = 1.6  # mm
# material of gecatsim, radius [mm] and centre [mm]; the centre is beside the axis, so that a mirrored panel is noticed
CYLINDERS = {
    "water": (100.0, (20.0, 10.0)),
    "Al": (20.0, (20.0, 10.0)),
    "ICRU_skeleton_cortical_bone_adult": (25.0, (20.0, 10.0)),
    "water_20C_iodine_10mg": (50.0, (20.0, 10.0)),
}
MIDDLE = 0.7  # part of a cylinder's radius
ENERGIES = np.array([40.5, 60.5, 80.5, 100.5, 120.5])  # keV
PULSE_THRESHOLDS = np.array([15.0, 20.0, 25.0, 35.0, 50.0, 65.0, 80.0, 100.0])  # keV
PHANTOM = """\
materialList = {{'{material}'}};

object.center(1,:) = [{x} {y} 0.0];
object.half_axes(1,:) = [{radius} {radius} 100.0];
object.euler_angs(1,:) = [0.0 0.0 0.0];
object.density(1) = 1.0;
object.type(1) = 2;
object.material(1) = 1;
object.axial_lims(1,:) = [0 0];
object.shape(1) = 0;
object.clip{{1}} = [];
"""


def material_of(package: Path, name: str) -> tuple[float, dict[str, float]]:
    """Density [g/cm^3] and mass fractions in a material file of gecatsim."""
    words = [line.split("#")[0].split() for line in (package / "material" / name).read_text().splitlines()]
    rows = [row for row in words if row]
    fractions = {symbol(int(row[0])): float(row[1]) for row in rows[2 : 2 + int(rows[0][0])]}
    total = sum(fractions.values())
    return float(rows[1][0]), {element: part / total for element, part in fractions.items()}


def symbol(number: int) -> str:
    """Symbol of an element."""
    import xraylib  # noqa: PLC0415

    return xraylib.AtomicNumberToSymbol(number)


def run(command: list[str], folder: Path) -> None:
    """Run a module in a folder, without what it prints unless it fails."""
    done = subprocess.run([sys.executable, "-m", *command], cwd=folder, check=False, capture_output=True, text=True)
    if done.returncode != 0:
        raise SystemExit(done.stderr[-1000:])


def their_log_projections(name: str, folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """Log projections (bin, column) of gecatsim, and the part of its open beam in each bin."""
    radius, (x, y) = CYLINDERS[name]
    (folder / "phantom.ppm").write_text(PHANTOM.format(material=name, radius=radius, x=x, y=y))
    run([__spec__.name, "--scan"], folder)
    air, scan = (np.fromfile(folder / f"scan.{kind}", np.float32).reshape(COLUMNS, -1).T for kind in ("air", "scan"))
    middle = air[:, COLUMNS // 2]
    return -np.log(scan / air), middle / middle.sum()


def scan_in_gecatsim() -> None:
    """Scan `phantom.ppm` of the working folder: one view, one ray per pixel, no noise."""
    import gecatsim  # noqa: PLC0415

    scan = gecatsim.CatSim()
    settings: dict[str, dict[str, Any]] = {
        "phantom": {"callback": "Phantom_Analytic", "projectorCallback": "C_Projector_Analytic"}
        | {"filename": "phantom.ppm", "centerOffset": [0.0, 0.0, 0.0], "scale": 1.0},
        "scanner": {"detectorColOffset": 0.0, "detectorColCount": COLUMNS, "detectorRowsPerMod": 1}
        | {"detectorRowCount": 1, "detectorPrefilter": [], "detectorMaterial": "CZT", "detectorDepth": SENSOR}
        | {"detectorColFillFraction": 1.0, "detectorRowFillFraction": 1.0, "detectionCallback": "Detection_PC"}
        | {"detectionResponseFilename": MATRIX, "detectorBinThreshold": [*THRESHOLDS, 160], "detectorSumBins": 0}
        | {"focalspotShape": "Uniform"},
        "protocol": {"viewsPerRotation": 4, "viewCount": 1, "stopViewId": 0, "bowtie": [], "flatFilter": ["Al", 3.0]}
        | {"spectrumFilename": SPECTRUM, "scanTypes": [1, 0, 1, 0]},
        "physics": {"energyCount": 120, "enableQuantumNoise": 0, "enableElectronicNoise": 0}
        | dict.fromkeys(("colSampleCount", "rowSampleCount", "srcXSampleCount", "srcYSampleCount"), 1)
        | {"viewSampleCount": 1},
    }
    for part, values in settings.items():
        vars(getattr(scan, part)).update(values)
    scan.resultsName, scan.do_prep = "scan", 0
    scan.run_all()


def write_response(package: Path, folder: Path) -> None:
    """Write the response matrix with the absorption of the sensor, and the spectrum, as tables."""
    known = loadmat(package / "response_matrix" / MATRIX)
    energies, deposited, matrix = known["Evec0"].ravel(), known["Dvec0"].ravel(), known["res_mat"]
    used = energies >= 10
    absorbed = -np.expm1(-SENSOR * CZT.attenuation(energies[used]))
    table = np.column_stack([energies[used], absorbed[:, None] * matrix[used]])
    header = ",".join(["energy", *(f"{middle:g}" for middle in deposited)])
    np.savetxt(folder / "response.csv", table, delimiter=",", header=header, comments="")
    photons = np.loadtxt(package / "spectrum" / SPECTRUM, delimiter=",", skiprows=1)
    np.savetxt(folder / "spectrum.txt", photons[(photons[:, 0] > 10) & (photons[:, 0] < 120)])


def our_log_projections(package: Path, name: str, folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """Log projections (bin, column) of this package in the order of gecatsim's columns, and the parts of the beam."""
    radius, centre = CYLINDERS[name]
    density, fractions = material_of(package, name)
    aluminium = {"composition": "Al", "density": material_of(package, "Al")[0], "thickness": 3.0}
    scene = {
        "version": 1,
        "name": "photon-counting",
        "source": {"type": "table", "file": "spectrum.txt", "values": "per_bin", "energies": "centres"}
        | {"filters": [aluminium], "photons": 1e6},
        "detector": {"type": "response_matrix", "file": "response.csv", "columns": "deposited", "per": "bin"}
        | {"thresholds": list(THRESHOLDS)},
        "geometry": {"type": "circular", "sod": SOD, "sdd": SDD, "views": 1, "test_views": 0, "start": 90.0},
        "panel": {"rows": 1, "columns": COLUMNS, "pitch": 1.0, "curvature": {"radius": SDD, "module_columns": 1}},
        "volume": {"voxels": 16, "size": 300},
        "basis": [{"type": "photoelectric"}, {"type": "compton"}],
        "materials": {"solid": {"composition": fractions, "density": density}},
        "objects": [
            {"type": "cylinder", "material": "solid", "radius": radius, "length": 200, "center": [*centre, 0.0]}
        ],
        "effects": {},
        "flats": 1,
    }
    (folder / "scene.yaml").write_text(yaml.safe_dump(scene))
    command = ["phantomgen", "make", "scene.yaml", "-o", "ours.h5", "--overwrite", "-q", "--no-noise", "--tol", "1e-5"]
    run(command, folder)
    with phantomgen.open(folder / "ours.h5") as dataset:
        middle = dataset.flat[:, 0, COLUMNS // 2]
        return -np.log(dataset.load()[0, :, 0, ::-1] / dataset.flat[:, 0, ::-1]), middle / middle.sum()


def chain_row(package: Path, name: str, folder: Path) -> tuple[str, np.ndarray]:
    """Differences behind one cylinder as a line, and the parts of the open beam over gecatsim's, less 1."""
    ours, beam = our_log_projections(package, name, folder)
    theirs, their_beam = their_log_projections(name, folder)
    radius = CYLINDERS[name][0]
    chord = theirs[2] / theirs[2].max()
    middle = chord > np.sqrt(1 - MIDDLE**2)
    relative = 100 * (ours[:, middle] / theirs[:, middle] - 1)
    energies = np.arange(20.5, 120.0)
    density, fractions = material_of(package, name)
    mu = spectra.linear_attenuation(fractions, density, energies)
    mu_theirs = their_attenuation(name, energies, folder)
    away = 100 * (mu / mu_theirs - 1)
    bins = " ".join(f"{np.mean(row):+7.2f}" for row in relative)
    line = (
        f"{name:<34}{2 * radius:>6.0f}{theirs[0].max():>7.2f}  {bins}   {np.median(away):+7.2f} {np.ptp(away) / 2:7.2f}"
    )
    return line, beam / their_beam - 1


def their_attenuation(name: str, energies: np.ndarray, folder: Path) -> np.ndarray:
    """Attenuation coefficients of gecatsim [1/mm]."""
    np.save(folder / "energies.npy", energies)
    run([__spec__.name, "--mu", name], folder)
    return np.load(folder / "mu.npy") / 10.0


def attenuation_in_gecatsim(name: str) -> None:
    """Write the attenuation coefficients at `energies.npy` [1/cm] to `mu.npy`."""
    from gecatsim.pyfiles.GetMu import GetMu  # noqa: PLC0415

    np.save("mu.npy", np.asarray(GetMu(name, np.load("energies.npy"))).ravel())


def pulses(resolution: float, cloud: float) -> np.ndarray:
    """Counts above each threshold per absorbed photon, (energy, threshold)."""
    limits = [*PULSE_THRESHOLDS, 200.0]
    bins = [spectra.Channel(f"{low:g}", low, high) for low, high in pairwise(limits)]
    sharing = spectra.ChargeSharing(pitch=0.25, cloud=cloud)
    detector = spectra.PulseHeightDetector(tuple(bins), CZT, SENSOR, resolution, True, sharing)
    return detector.pulses(ENERGIES)[::-1].cumsum(axis=0)[::-1].T


def sensor_table(package: Path) -> None:
    """Print both responses, the second with the resolution and the cloud that fit the first best."""
    known = loadmat(package / "response_matrix" / MATRIX)
    energies, deposited, matrix = known["Evec0"].ravel(), known["Dvec0"].ravel(), known["res_mat"]
    rows = [matrix[np.argmin(np.abs(energies - energy))] for energy in ENERGIES]
    theirs = np.array([[row[deposited > threshold].sum() for threshold in PULSE_THRESHOLDS] for row in rows])

    def misfit(parameters: np.ndarray) -> float:
        return float(np.sum((pulses(parameters[0], parameters[1] / 100) - theirs) ** 2))

    best = minimize(
        misfit, (7.0, 2.7), method="Nelder-Mead", bounds=((2, 12), (0.5, 6)), options={"maxfev": 60, "xatol": 0.02}
    ).x
    ours = pulses(best[0], best[1] / 100)
    print(f"\nresolution {best[0]:.1f} keV, cloud {best[1] / 100:.3f} mm: rms difference {np.std(ours - theirs):.3f}")
    print("counts per absorbed photon above [keV]" + "".join(f"{threshold:>8.0f}" for threshold in PULSE_THRESHOLDS))
    for energy, row, other in zip(ENERGIES, ours, theirs, strict=True):
        for who, values in (("gecatsim", other), ("ours", row)):
            print(f"{energy:>5.1f} keV  {who:<27}" + "".join(f"{value:>8.3f}" for value in values))


def main() -> None:
    if sys.argv[1:] == ["--scan"]:
        scan_in_gecatsim()
        return
    if sys.argv[1:2] == ["--mu"]:
        attenuation_in_gecatsim(sys.argv[2])
        return
    import gecatsim  # noqa: PLC0415

    package = Path(gecatsim.__file__).parent
    os.environ["PYTHONPATH"] = os.pathsep.join(str(Path(place or ".").resolve()) for place in sys.path)
    bins = " ".join(
        f"{low:>4.0f}-{high:<3}" for low, high in zip(THRESHOLDS, [*map(int, THRESHOLDS[1:]), ""], strict=True)
    )
    print("log projection over gecatsim's, less 1 [%], by bin [keV]; attenuation: median and half range, 20 to 120 keV")
    print(f"{'material':<34}{'[mm]':>6}{'most':>7}  {bins}   attenuation [%]")
    with TemporaryDirectory() as name:
        folder = Path(name)
        write_response(package, folder)
        for material in CYLINDERS:
            line, beam = chain_row(package, material, folder)
            print(line, flush=True)
    print("open beam in each bin [%]".ljust(47) + "  " + " ".join(f"{100 * value:+7.2f}" for value in beam))
    sensor_table(package)


if __name__ == "__main__":
    main()
