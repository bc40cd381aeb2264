"""Dose of the body phantom of AAPM Report 195, case 4, against the mean of the codes in the report.

    python -m benchmarks.simulator.dose [--photons 20000000]

A cylinder of PMMA, 32 cm across and 3 m long, in air, before an isotropic source of 56.4 keV at 60 cm, which is
collimated to 32 cm x 1 or 8 cm at the isocentre. Energy per photon [eV] in slices of 10 mm, from the beam's middle
outwards, and in rods of 10 x 100 mm: in the middle, below the surface towards the source, and on the far side. Writes
`results/dose.txt`.
"""

import argparse
import platform
import time
from pathlib import Path

import numpy as np

from phantomgen.dose.crossings import crossings_of
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.ops.photon_transport import transport
from phantomgen.ops.photon_transport.inputs import Beam, Medium, Probes
from phantomgen.ops.voxelize_shapes import fractions
from phantomgen.shapes import Cylinder, solids_of
from spectra.materials.material import Material
from spectra.threads import run_parallel, thread_count

TABLE = Path(__file__).parents[1] / "results" / "dose.txt"
ENERGY, SOURCE, RADIUS, LENGTH = 56.4, 600.0, 160.0, 3000.0  # keV; mm
VOXEL, SLICE = 5.0, 20.0  # mm
PMMA = Material("PMMA", density=1.19, composition="C5H8O2")
AIR = Material("air", density=1.205e-3, composition={"C": 0.000124, "N": 0.755268, "O": 0.231781, "Ar": 0.012827})
BATCHES = 40
PLACES = ("slice 1", "slice 2", "slice 3", "slice 4", "rod in the middle", "rod near the source", "rod behind")
# Means of the codes of the report (Sechopoulos et al. 2015, doi:10.1118/1.4928676), case 4.1, and 4.2 at 0 degrees for
# the rods; at 180 degrees for the one behind. From the validation program of DXMClib (E. Andersen), which quotes them.
REPORT = {
    10.0: (11592.27, 2576.72, 1766.85, 1330.53, 12.168675, 101.29375, 0.52163),
    80.0: (3380.39, 3332.64, 3176.44, 2559.58, 11.630625, 99.665175, 0.49996925),
}
ENDS = ((-5.0, 5.0), (-15.0, -5.0), (-25.0, -15.0), (-35.0, -25.0), *((-50.0, 50.0),) * 3)
HEADER = "cm  place                      here    +-        report   dif %   +- %  10^6/s"
RODS = ((0.0, 0.0), (-150.0, 0.0), (150.0, 0.0))


def beam_of(width: float) -> Beam:
    """Photons per area fall as the cube of the cosine, as those of an isotropic source on a plane."""
    columns, rows = 640, 20
    step, high = 2 * RADIUS / columns, width / rows
    frame = np.array([[-SOURCE, 0, 0], [SOURCE, -RADIUS + step / 2, (high - width) / 2], [0, step, 0], [0, 0, high]])
    y, z = (np.arange(columns) + 0.5) * step - RADIUS, (np.arange(rows) + 0.5) * high - width / 2
    cube = 1.5 * np.log1p((y**2 + z[:, None] ** 2) / SOURCE**2)[None]
    one = np.array([2.0])
    return Beam(frame[None, None], one, rows, columns, np.array([ENERGY]), one, cube, np.ones((1, 1)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--photons", type=float, default=2e7)
    photons = int(parser.parse_args().photons)
    across, along = 2 * SOURCE / VOXEL, LENGTH / SLICE
    first = -SOURCE + VOXEL / 2
    grid = Grid((int(along), int(across), int(across)), (SLICE, VOXEL, VOXEL), (-(LENGTH - SLICE) / 2, first, first))
    cylinder = solids_of([(Cylinder((0, 0, 0), RADIUS, LENGTH), 0)])
    filled = fractions(grid, cylinder, 2, background=1).astype(float)
    medium = Medium(filled, np.array(grid.origin) - np.array(grid.spacing) / 2, np.array(grid.spacing))
    centres = np.array([*((0.0, 0.0),) * 4, *RODS])
    probes = Probes(centres, np.array([RADIUS + 8] * 4 + [5.0] * 3), np.array(ENDS))
    crossings = crossings_of((PMMA, AIR), ENERGY + 1)
    lines = [f"{platform.machine()}, {thread_count()} threads, {photons:g} photons per beam", HEADER]
    print(*lines, sep="\n")
    for width, reported in REPORT.items():
        beam, began = beam_of(width), time.perf_counter()
        found = run_parallel(
            lambda seed, beam=beam: transport(photons // BATCHES, seed, beam, medium, crossings, probes),
            range(BATCHES),
        )
        each = np.array([batch.energy / batch.ends[0] * 1e3 * ENERGY for batch in found])
        seconds = time.perf_counter() - began
        mean, error = each.mean(axis=0), each.std(axis=0, ddof=1) / np.sqrt(BATCHES)
        for place, a, b, wanted in zip(PLACES, mean, error, reported, strict=True):
            line = f"{width / 10:<4g}{place:<21}{a:10.3f}{b:8.3f}{wanted:12.3f}{100 * (a / wanted - 1):+8.2f}"
            print(line + f"{100 * b / wanted:7.2f}{photons / seconds / 1e6:8.2f}", flush=True)
            lines.append(line + f"{100 * b / wanted:7.2f}{photons / seconds / 1e6:8.2f}")
    TABLE.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
