"""What an error of the stated spectrum costs a scan with one channel, and what its counts tell of the spectrum.

    python -m benchmarks.reconstruction.one_energy_spectrum [--threads N]

`metal-hip` with a single threshold is simulated as the scene states it, and reconstructed by one-step voxels along the
standard curve of materials with other spectra: stated less true voltage [kV] and thickness of the aluminium filter
[mm]. A row states PSNR [dB] and root mean square error [HU] of the attenuation at 70 keV as
`benchmarks.reconstruction.one_energy` does; the mean error of tissue more than three voxels from metal and surface [%];
and the deviance per ray of the best voxels, rays beside edges left out, which a search for the spectrum would make as
small as it can. Rows take the place of those in `results/one_energy_spectrum.txt`.
"""

import argparse
import platform
import tempfile
from pathlib import Path

import numpy as np
from scipy.ndimage import binary_dilation

import phantomgen
from benchmarks.reconstruction.one_energy import BONE, METAL, SCENES
from benchmarks.result_rows import store
from phantomgen.dataset.reader import Dataset
from phantomgen.dataset.truth import read_truth
from recon.calibration.perturbation import Perturbation
from recon.calibration.refine import FILTER
from recon.kedge.basis_names import OnCurve
from recon.scatter.voxel_fit import VoxelFit
from recon.voxel.method import no_callback
from spectra.materials.material import Material
from spectra.materials.material_curve import ENERGY
from spectra.threads import set_threads, thread_count, without_other_pools

TABLE = Path(__file__).parents[1] / "results" / "one_energy_spectrum.txt"
ERRORS = ((0.0, 0.0), (2.0, -0.25), (-2.0, 0.25), (5.0, -1.0), (-20.0, 0.0))  # stated less true: kV, mm
TISSUE = (0.018, 0.0215)  # 1/mm at 70 keV, of the voxels whose mean error is stated
NAMED = 14  # characters of a row for its error
HEADER = (
    f"{'kV':>6}{'mm Al':>8}{'all [dB]':>10}{'no metal':>10}{'apart [HU]':>12}{'tissue [%]':>12}{'deviance per ray':>18}"
)


def row_of(dataset: Dataset, error: tuple[float, float]) -> str:
    """One line of the results."""
    truth = read_truth(dataset.path)
    assert truth is not None
    true = np.tensordot(dataset.spectra.basis.evaluate(np.array([ENERGY]))[:, 0], truth.volumes, axes=1)
    parts = Perturbation.of(dataset, Material(FILTER, None, FILTER))
    stated = dataset.with_spectra(parts.corrected(np.array(error), dataset.spectra))
    fit = VoxelFit.of(stated, OnCurve(), no_callback)
    volumes, grid = fit.volumes(fit.dataset, max(dataset.grid.shape))
    at = fit.dataset.spectra.basis.evaluate(np.array([ENERGY]))[:, 0]
    found = np.einsum("m,mzyx->zyx", at, volumes)
    squares, soft = (found - true) ** 2, true < METAL
    apart = ~binary_dilation(~soft, iterations=3) & (true > 0)
    tissue = apart & (true > TISSUE[0]) & (true < TISSUE[1])
    water = OnCurve().curve(fit.dataset)
    unit = water.attenuations[water.materials.index("water")] / 1000  # 1/mm, of a Hounsfield unit
    whole, without = 10 * np.log10(true.max() ** 2 / squares.mean()), 10 * np.log10(BONE**2 / squares[soft].mean())
    rms = np.sqrt(squares[apart].mean()) / unit
    bias = 100 * np.mean((found - true)[tissue]) / np.mean(true[tissue])
    return (
        f"{error[0]:>+6.0f}{error[1]:>+8.2f}{whole:>10.2f}{without:>10.2f}{rms:>12.1f}"
        f"{bias:>+12.2f}{fit.deviance_per_ray(volumes, grid):>18.3f}"
    )


@without_other_pools()
def main() -> None:
    """Measure and store the rows."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--threads", type=int)
    set_threads(parser.parse_args().threads)
    print(HEADER)
    with tempfile.TemporaryDirectory() as folder:
        scene = phantomgen.load(*SCENES["metal-hip"])
        with phantomgen.make(scene, out=Path(folder) / "one.h5", overwrite=True) as dataset:
            for error in ERRORS:
                row = row_of(dataset, error)
                store(TABLE, [f"{platform.machine()}, {thread_count()} threads", HEADER], row, NAMED)
                print(row, flush=True)


if __name__ == "__main__":
    main()
