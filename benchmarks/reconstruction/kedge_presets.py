"""Which K edges the search finds on presets, and how large a misfit it has to allow on scans without an edge.

    python -m benchmarks.reconstruction.kedge_presets

**Presets** are scanned with as many views as the search looks at, their truth is never read, and edges are looked for
as `recon fit --edge auto` does: at all energies, beside the functions of the file without an edge.

**Blank scans** are simulated with the source and detector of `contrast-vials` and hold no element with a K edge in the
spectrum. Each is judged for iodine, gadolinium and gold as `recon fit --bases auto` does, once on binned rays, once by
neighbouring rays; what is printed is the relative error of expected counts that has to be allowed (`MISFIT` in
`recon.kedge.expected_noise`), so that the score stays below what a K edge needs. 0 stands for scans that noise
explains. Few photons hide misfits in noise, many do not: so scans have as many as the preset, and ten times more.
"""

import argparse
import platform
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from unittest.mock import patch

import numpy as np

import phantomgen
from phantomgen.dataset.reader import Dataset
from recon.kedge import expected_noise
from recon.kedge.alternatives import deviance_drops
from recon.kedge.choose_basis import DISPERSION, choose_basis
from recon.kedge.edge_likelihood import EdgeLikelihood
from recon.kedge.expected_noise import NullDistribution, excess_score, null_distribution
from recon.kedge.judgement import JUDGED_RAYS, LEAST_SCORE, POOL_RAYS, RAY_FRACTIONS
from recon.kedge.rays import VIEWS, rays_away_from_edges
from recon.kedge.spatial_correlation import correlation_score
from spectra.basis.basis import Basis, BasisFunction
from spectra.threads import set_threads

RESULTS = Path(__file__).parents[1] / "results" / "kedge_presets.txt"
SHORT = (f"geometry.views={VIEWS}", "geometry.test_views=0")
# K edges that are in the scenes [keV]: a step, or that of iodine; the other two hold none within the spectrum.
PRESETS = {
    "kedge-small": (63.3,), "multi-energy": (33.17,), "kedge": (63.3,), "bird-chest": (), "metal-hip": (),
}  # fmt: skip
NEAR = 1.0  # an edge found so close to one of the scene is that one [keV]

PLAIN = (BasisFunction("photoelectric"), BasisFunction("compton"))
ELEMENTS = ("I", "Gd", "Au")
_ROUND = "objects=[{{type: cylinder, material: {0}, radius: {1}, length: 100}}{2}]"


def _rods(*rods: tuple[str, float, float, float]) -> str:
    """Cylinders by material, place and radius [mm]."""
    form = ", {{type: cylinder, material: {0}, center: [{1}, {2}, 0], radius: {3}, length: 100}}"
    return "".join(form.format(*rod) for rod in rods)


_MANY = [(("metal", "bone", "calcium")[i % 3], 38 * np.cos(i / 2), 38 * np.sin(i / 2), 1 + i % 3) for i in range(12)]
BLANKS = {
    "PMMA": _ROUND.format("acrylic", 50, ""),
    "water, bone": _ROUND.format("water", 50, _rods(("bone", 25, 0, 12), ("bone", -20, 15, 8), ("bone", -5, -30, 5))),
    "aluminium, 30 mm": _ROUND.format("metal", 15, ""),
    "aluminium, 40 mm": _ROUND.format("metal", 20, ""),
    "PMMA, Al, steel, Ca": _ROUND.format(
        "acrylic", 30, _rods(("metal", 15, 0, 6), ("steel", 0, 15, 1), ("calcium", -15, 0, 8), ("bone", 0, -15, 5))
    ),
    "thin rods": _ROUND.format("acrylic", 50, _rods(*_MANY)),
}
_MATERIALS = (
    "materials={acrylic: {composition: PMMA}, water: {composition: 'Water, Liquid'}, bone: {composition: cortical bone}"
    ", metal: {composition: Al}, steel: {composition: Fe}, calcium: {solution: {solvent: water, solutes: {Ca: 100}}}}"
)
_LAID = ("panel={rows: 24, columns: 256, pitch: 0.8}", "basis=[{type: photoelectric}, {type: compton}]")
MOST = 0.02  # misfit that is tried at most


def searched(name: str, edges: tuple[float, ...], folder: Path) -> str:
    """One preset: which edges are in it, which were found, and how long it took."""
    dataset = phantomgen.make(phantomgen.load(name, SHORT), folder / "scan.h5", overwrite=True)
    with dataset:
        began = time.perf_counter()
        choice = choose_basis(dataset, None, ())
        seconds = time.perf_counter() - began
    found = [profile.best for _, profile in choice.profiles]
    missing = [edge for edge in edges if not any(abs(edge - one) < NEAR for one in found)]
    wrong = [one for one in found if not any(abs(edge - one) < NEAR for edge in edges)]
    scores = ", ".join(f"{j.name} {j.score:.1f}" for j in choice.judgements)
    said = [f"missing {_list(missing)}"] * bool(missing) + [f"false {_list(wrong)}"] * bool(wrong)
    return f"{name:14}{_list(edges):>10}{_list(found):>16}{seconds:>7.0f} s   {'; '.join(said) or 'right':24}{scores}"


def _list(energies: list[float] | tuple[float, ...]) -> str:
    """Energies [keV] in words."""
    return ", ".join(f"{energy:.2f}" for energy in energies) or "none"


def blank(name: str, photons: float, seed: int, folder: Path) -> str:
    """Misfit that one scan without an edge needs, for each element, by single and by neighbouring rays."""
    settings = (*SHORT, _MATERIALS, BLANKS[name], *_LAID, f"source.photons={photons}", f"seed={seed}")
    with phantomgen.make(phantomgen.load("contrast-vials", settings), folder / "scan.h5", overwrite=True) as dataset:
        binned, pixels = (_likelihood(dataset, joined) for joined in (True, False))
    cells = []
    for element in ELEMENTS if len(binned.rays) else ():
        further = BasisFunction("element", element=element)
        cells.append(f"{100 * needed_single(binned, further):.3f} {100 * needed_neighbours(pixels, further):.3f}")
    said = "".join(f"{cell:>16}" for cell in cells) or "   no ray has counts enough in all channels"
    return f"{name:20}{photons:>9.0e}{seed:>6}{len(binned.rays):>8}{said}"


def _likelihood(dataset: Dataset, binned: bool) -> EdgeLikelihood:
    """Of all rays that a fit judges."""
    rays = rays_away_from_edges(dataset.with_basis(Basis(PLAIN)), binned)
    return EdgeLikelihood(rays, dataset.spectra, dataset.dark_variance / dataset.spectra.quantum**2, DISPERSION)


def needed_single(likelihood: EdgeLikelihood, further: BasisFunction) -> float:
    """Least misfit with which single rays do not warrant a function, chosen as `recon.kedge.judgement.judge` does."""
    saved, lengths = likelihood.saving(PLAIN)(further)
    saved = np.where((lengths > 0) & (saved > 0), saved, 0.0)
    pool = likelihood.with_rays(likelihood.rays[likelihood.rays.highest(saved, POOL_RAYS)])
    saved = deviance_drops(pool, PLAIN, further)
    law = null_distribution(pool, PLAIN, further, pool.deviances(PLAIN)[1], misfit=1.0)
    ranked = pool.rays.highest(saved, JUDGED_RAYS)
    choices = [ranked[: JUDGED_RAYS // part] for part in RAY_FRACTIONS]

    def score(misfit: float) -> float:
        some = NullDistribution(law.variance, misfit * law.shift)
        return max(excess_score(saved[rays], some[rays]) for rays in choices)

    return _least(score, 12)


def needed_neighbours(likelihood: EdgeLikelihood, further: BasisFunction) -> float:
    """The same by whether neighbouring rays agree."""

    def score(misfit: float) -> float:
        with patch.object(expected_noise, "MISFIT", misfit):
            return correlation_score(likelihood, PLAIN, further)

    return _least(score, 6)


def _least(score: Callable[[float], float], halvings: int) -> float:
    """Where a falling score reaches what a K edge needs; 0 where it is never above."""
    if score(0.0) < LEAST_SCORE:
        return 0.0
    low, high = 0.0, MOST
    for _ in range(halvings):
        middle = (low + high) / 2
        low, high = (middle, high) if score(middle) >= LEAST_SCORE else (low, middle)
    return high


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--presets", default=",".join(PRESETS), help="names with commas between, or none")
    parser.add_argument("--blanks", default=";".join(BLANKS), help="blank scans with semicolons between, or none")
    parser.add_argument("--photons", default="4e5,4e6", help="of blank scans, per pixel and view")
    parser.add_argument("--seeds", type=int, default=1, help="of each blank scan")
    parser.add_argument("--no-write", action="store_true", help="leave the results file as it is")
    options = parser.parse_args()
    set_threads(1)
    lines = [f"{'':14}{'edges':>10}{'found [keV]':>16}{'search':>9}"]
    with tempfile.TemporaryDirectory() as name:
        for preset in filter(None, options.presets.split(",")):
            lines.append(searched(preset, PRESETS[preset], Path(name)))
            print(lines[-1], flush=True)
        lines += ["", "misfit that blank scans need [%], by single rays and by neighbouring rays"]
        lines.append(f"{'':20}{'photons':>9}{'seed':>6}{'rays':>8}" + "".join(f"{element:>16}" for element in ELEMENTS))
        for blank_name in filter(None, options.blanks.split(";")):
            for photons in map(float, options.photons.split(",")):
                for seed in range(options.seeds):
                    lines.append(blank(blank_name, photons, seed, Path(name)))
                    print(lines[-1], flush=True)
    head = f"benchmarks/reconstruction/kedge_presets.py, one thread, Python {platform.python_version()}"
    if not options.no_write:
        RESULTS.write_text("\n".join([head, "", *lines]) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
