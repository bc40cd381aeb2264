"""
A K-edge scan from Python
=========================

Build the scan, simulate it, reconstruct it, and look at what is left to improve.

A K-edge material absorbs much more above one energy, its K edge, than just below. A detector that counts photons in
energy channels sees that jump, so three volumes can be told apart: photoelectric absorption, Compton scatter, and the
K-edge material. This script goes the whole way for a cylinder of soft tissue that holds bone and two concentrations of
a K-edge material. Run it as one of::

    python examples/plot_kedge.py           # 64^3 voxels, about a minute
    python examples/plot_kedge.py --quick   # 24^3 voxels, seconds: coarse, to see that everything works

The scene below says in Python what ``kedge.yaml`` beside it says as a file: ``phantomgen make examples/kedge.yaml``
writes the same counts, and a test holds the two to each other.
"""

# sphinx_gallery_thumbnail_path = 'images/kedge-axial.png'

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import phantomgen
from phantomgen.dataset.truth import read_truth
from phantomgen.geometry.orbits import spread_angles
from phantomgen.geometry.panel import Panel
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.scene.scan import Scan, SceneObjects
from phantomgen.shapes import Cylinder
from recon.evaluation.scoring import held_out_views, score_test_views, score_truth
from recon.figures import run_figures as figures
from recon.gaussians.recipe import Recipe
from recon.gaussians.reconstruct import reconstruct
from recon.runs.write_run import score_table
from spectra import Basis, BasisFunction, Detector, Material, Source
from spectra.source.source import Filter

FOLDER = Path("kedge-example-run")


@dataclass(frozen=True)
class Size:
    """How fine the scan."""

    views: int = 45
    test_views: int = 20
    pixels: int = 128
    voxels: int = 64


QUICK = Size(views=15, test_views=2, pixels=48, voxels=24)


# %%
# What attenuates
# ---------------
# Attenuation is a sum of functions of energy, each times a volume: mu(x, E) = sum_m B_m(E) alpha_m(x). The functions
# are photoelectric absorption (E^-3), Compton scatter (Klein-Nishina) and a step at the K edge. All are 1 at 70 keV, so
# a coefficient reads as "the attenuation that this mechanism adds at 70 keV", in 1/mm.


def kedge_basis() -> Basis:
    """Three functions; 63.3 keV is about the K edge of lutetium."""
    return Basis((BasisFunction("photoelectric"), BasisFunction("compton"), BasisFunction("step", edge_energy=63.3)))


# Objects are solids in millimetres. Where two overlap, the later one wins: bone and contrast are drilled out of the
# tissue. Materials here are plain coefficients; `Material("water", composition="H2O", density=1.0)` would do as well,
# and be simulated with its tabulated attenuation.


def kedge_scene() -> SceneObjects:
    """Bone and two K-edge cylinders in soft tissue."""
    materials = {
        "soft_tissue": {"photoelectric": 0.0015, "compton": 0.0188},
        "bone": {"photoelectric": 0.0173, "compton": 0.0320},
        "contrast_high": {"photoelectric": 0.0067, "compton": 0.0180, "kedge_63.3": 0.0250},
        "contrast_low": {"photoelectric": 0.0041, "compton": 0.0179, "kedge_63.3": 0.0125},
    }
    cylinders = (
        Cylinder(center=(0, 0, 0), radius=50, length=100),
        Cylinder(center=(-22, 6, 0), radius=13, length=80),
        Cylinder(center=(22, -6, 0), radius=11, length=80),
        Cylinder(center=(0, -28, 0), radius=9, length=80),
    )
    return SceneObjects(
        objects=tuple((cylinder, material) for material, cylinder in enumerate(cylinders)),
        materials=tuple(Material(name, coefficients=values) for name, values in materials.items()),
    )


# %%
# How it is scanned
# -----------------
# A tungsten tube at 140 kV behind 2.5 mm of aluminium; a CdTe detector that sorts photons into four channels, with a
# threshold on the K edge, because two channels that meet at the edge see the jump best. The source runs around z on a
# circle of 500 mm. Test views lie between the training views; the fit never sees them.


def kedge_scan(size: Size) -> Scan:
    """Everything that the simulator needs."""
    aluminium = Filter(Material("Al", composition="Al"), thickness=2.5)
    source = Source.tube(kvp=140, photons=2e5, angle=12, filters=[aluminium])
    angles = spread_angles(size.views, size.test_views)
    panel = Panel(size.pixels, size.pixels, pitch=204.8 / size.pixels)
    views = np.arange(len(angles))
    return Scan(
        name="kedge-example",
        scene=kedge_scene(),
        geometry=Geometry.circular(sod=500, sdd=800, angles=angles, panel=panel),
        splits={"train": views[: size.views], "test": views[size.views :], "val": views[:0]},
        source=source,
        detector=Detector.photon_counting([20, 45, 63.3, 80], top=source.maximum, material="CdTe", thickness=1.6),
        basis=kedge_basis(),
        grid=Grid.cube(size.voxels, size=128),
        seed=0,
        noise=True,
        flats=50,
        darks=1,
        source_fields={
            "type": ("Fixed Tube X-ray", None),
            "voltage": (140.0, "kV"),
            "target_material": ("tungsten", None),
        },
        text="made by examples/plot_kedge.py",
    )


# %%
# From counts to volumes
# ----------------------
# ``phantomgen.make`` writes the counts of every view and, apart from them, the truth. ``reconstruct`` reads the counts
# only. It takes partial volume out of them, finds voxels of all bases at once by Poisson likelihood and joint total
# variation, coarse ones first; places Gaussians, flat along edges and sparse inside; moves them until their volumes are
# those voxels; and then lets them follow the likelihood of all counts again. The default recipe goes over the training
# views once. ``docs/reference/benchmarks/ablation.md`` says what each stage contributes. The truth is opened for the
# score and figures.


def main(folder: Path = FOLDER, size: Size = Size()) -> dict:
    """Simulate, reconstruct, print the scores, draw; returns the scores."""
    folder.mkdir(parents=True, exist_ok=True)
    with phantomgen.make(kedge_scan(size), folder / "scan.h5", overwrite=True) as dataset:
        print(dataset, end="\n\n")
        result = reconstruct(dataset, Recipe())
        truth = read_truth(dataset.path)
        scores = {**score_truth(truth, result.gaussians), "channels": score_test_views(dataset, result.gaussians)}
        print(f"{result.gaussians}, {sum(result.seconds.values()):.0f} s")
        print(score_table(scores))
        result.gaussians.save(folder / "model.safetensors")
        for path in draw(dataset, truth, result.gaussians, folder):
            print(path)
    return scores


# %%
# What to look at
# ---------------
# ``axial.png``: truth, result and their difference, per basis. What is left stands at the edges. ``profiles.png`` runs
# through both K-edge cylinders: the two plateaus should stand at 0.0250 and 0.0125 1/mm. ``residuals.png`` compares a
# test view with what the model expects there, in standard deviations of the Poisson noise: the closer the histogram
# away from edges comes to the unit normal, the less is left to explain.


def draw(dataset, truth, gaussians, folder: Path) -> list[Path]:
    """Slices, profiles, and the residuals of the first test view."""
    names, volumes = gaussians.basis_names, gaussians.volume(truth.grid)
    view = next(held_out_views(dataset, gaussians))
    channels = dataset.spectra.channels
    paths = [folder / f"{name}.png" for name in ("axial", "profiles", "residuals")]
    figures.basis_slices(volumes, truth.volumes, names, truth.grid, paths[0])
    figures.profiles({"result": volumes}, truth.volumes, names, truth.grid, paths[1])
    figures.residuals(view.counts, view.expected, channels, paths[2], view.away)
    return paths


if __name__ == "__main__":
    main(size=QUICK if "--quick" in sys.argv[1:] else Size())
