"""Scatter behind a cube of water beside ompMC, a Monte Carlo code for photons and electrons.

    pip install ompmc
    python -m benchmarks.peers.scatter [--histories 1e6]

A point source of 60 keV, 500 mm from the centre of a cube of 60 mm, irradiates the cube alone; a panel stands 800.5 mm
from the source. Ours is the single Compton scatter of `effects: {scatter: {type: compton}}`, of free electrons. ompMC
follows every photon through all orders of Compton and coherent scattering, of bound electrons; its panel is 1 mm of
silver, which absorbs all photons, and whose energy is tallied. At a tenth of the density of water hardly any photon
scatters twice. A row states the signal per pixel of 20 mm over that of the open beam in the middle of the panel, in
rings outside of the shadow of the cube, the ratio of both, and its standard error. Rows take the place of those in
`results/scatter_peer.txt`.
"""

import argparse
import tempfile
from importlib.metadata import version
from pathlib import Path

import numpy as np
import yaml
from jaxtyping import Float

import phantomgen
from benchmarks.result_rows import store

TABLE = Path(__file__).parents[1] / "results" / "scatter_peer.txt"
ENERGY, SOD, SDD, EDGE, PITCH, PIXELS = 60.0, 500.0, 800.5, 60.0, 20.0, 20  # keV, mm
PANEL = 1.0  # mm of silver
DENSITIES = {"water": 1.0, "water of a tenth of the density": 0.1}  # g/cm^3
RINGS = ((70, 100), (100, 130), (130, 160), (160, 190), (190, 230), (230, 280))  # mm from the middle of the panel
SHADOW = 65.0  # mm; half the side of the square around the shadow that is left out
NAMED = 44  # characters of a row for its material and ring
HEADER = f"{'material, ring [mm], angle':<{NAMED}}{'ours':>10}{'ompMC':>10}{'ratio':>8}{'+-':>7}"

Image = Float[np.ndarray, "row column"]


def ours(density: float, folder: Path) -> Image:
    """Scattered signal over that of the open beam in the middle of the panel."""
    scene = {
        "version": 1,
        "name": "cube",
        "source": {"type": "monochromatic", "energy": ENERGY, "photons": 1e6},
        "detector": {"type": "energy_integrating"},
        "geometry": {"type": "circular", "sod": SOD, "sdd": SDD, "views": 1, "test_views": 0},
        "panel": {"rows": PIXELS, "columns": PIXELS, "pitch": PITCH},
        "volume": {"voxels": 48, "size": 1.2 * EDGE},
        "basis": [{"type": "photoelectric"}, {"type": "compton"}],
        "materials": {"water": {"composition": "water", "density": density}},
        "objects": [{"type": "box", "material": "water", "size": [EDGE] * 3}],
        "noise": False,
    }
    images = []
    for effects in ({}, {"effects": {"scatter": {"type": "compton"}}}):
        path = folder / "cube.yaml"
        path.write_text(yaml.safe_dump(scene | effects))
        with phantomgen.make(path, out=folder / "cube.h5", overwrite=True) as dataset:
            images.append(dataset.load([0])[0, 0].astype(np.float64))
            middle = dataset.flat[0, PIXELS // 2 - 1 : PIXELS // 2 + 1, PIXELS // 2 - 1 : PIXELS // 2 + 1].mean()
    return (images[1] - images[0]) / middle


def by_ompmc(density: float, histories: int) -> tuple[Image, Image]:
    """The same by ompMC, of all that does not come straight from the source, and its standard error."""
    import ompmc  # noqa: PLC0415 - only where it is wanted

    half, front = EDGE / 2, SOD - EDGE / 2
    pixels = (np.arange(PIXELS + 1) - PIXELS / 2) * PITCH
    across = np.unique([*pixels, -half, half])
    along = np.array([0.0, EDGE, SDD - PANEL / 2 - front, SDD + PANEL / 2 - front])
    middles = (across[:-1] + across[1:]) / 2
    inside = np.abs(middles) < half
    material = np.zeros((len(middles), len(middles), 3), np.int32, order="F")
    material[..., 0], material[..., 2] = inside[:, None] & inside, 2
    densities = np.asfortranarray(np.select([material == 1, material == 2], [density, 10.5], 0.0))
    media = ["H2O521ICRU", "AG521ICRU"]
    geometry = ompmc.Geometry(across / 10, across / 10, along / 10, media, densities, material)
    opening = ompmc.CollimatedSource(front / 10, *(side * half / 10 for side in (-1, 1, -1, 1)))
    physics = ompmc.Physics(pegs_file=Path(ompmc.data_path()) / "pegs4" / "521icru.pegs4dat", n_split=1)
    energy, relative, *_ = ompmc.calc_cube(
        geometry,
        opening,
        ompmc.Spectrum.monoenergetic(ENERGY / 1000),
        physics,
        n_histories=histories,
        output_dose=False,
    )
    lit = EDGE**2 * (SDD / front) ** 2  # mm^2 of the panel that the opening would light
    open_beam = ENERGY / 1000 * PITCH**2 / lit  # MeV per history
    place = np.searchsorted(pixels, middles) - 1
    sums, squares = np.zeros((2, PIXELS, PIXELS))
    np.add.at(sums, (place[:, None], place), energy[..., 2])
    np.add.at(squares, (place[:, None], place), (energy[..., 2] * relative[..., 2]) ** 2)
    return sums / open_beam, np.sqrt(squares) / open_beam


def rows(name: str, histories: int, folder: Path) -> list[str]:
    """Rows of a material."""
    single = ours(DENSITIES[name], folder)
    whole, error = by_ompmc(DENSITIES[name], round(histories / DENSITIES[name] ** 0.5))
    place = (np.arange(PIXELS) - (PIXELS - 1) / 2) * PITCH
    away = np.hypot(place[:, None], place)
    shadow = (np.abs(place)[:, None] < SHADOW) & (np.abs(place) < SHADOW)
    found = []
    for low, high in RINGS:
        ring = (away >= low) & (away < high) & ~shadow
        ratio = whole[ring].sum() / single[ring].sum()
        spread = np.sqrt((error[ring] ** 2).sum()) / single[ring].sum()
        angle = np.rad2deg(np.arctan(away[ring].mean() / (SDD - SOD)))
        label = f"{name}, {low} to {high}, {angle:.0f}"
        found.append(
            f"{label:<{NAMED}}{single[ring].mean():>10.2e}{whole[ring].mean():>10.2e}{ratio:>8.3f}{spread:>7.3f}"
        )
    return found


def main() -> None:
    """Measure and store the rows."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--histories", type=float, default=1e6, help="photons of ompMC in water; default: %(default)g")
    histories = round(parser.parse_args().histories)
    print(HEADER)
    with tempfile.TemporaryDirectory() as folder:
        for name in DENSITIES:
            for row in rows(name, histories, Path(folder)):
                print(row, flush=True)
                store(TABLE, [f"ompMC {version('ompmc')}, {histories} photons", HEADER], row, NAMED)


if __name__ == "__main__":
    main()
