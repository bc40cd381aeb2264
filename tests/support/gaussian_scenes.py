"""Small Gaussian scenes, geometries and spectral models that several tests share."""

import numpy as np
import torch

from phantomgen.geometry.panel import Panel
from phantomgen.geometry.poses import Geometry
from recon.data.measurements import Measurements
from recon.gaussians.model import Gaussians
from spectra.transmission import Transmission

NAMES = ("photoelectric", "compton", "kedge")
SOD, SDD, PITCH = 60.0, 100.0, 1.5
PIXEL = PITCH * SOD / SDD  # edge of a pixel at the isocentre [mm]

# standard deviations along the principal axes, in pixels at the isocentre: (lowest, highest)
REGIMES = {"narrow": (0.05, 0.3), "typical": (0.5, 2.0), "wide": (3.0, 8.0), "needle": (0.3, 9.0)}


def random_gaussians(seed, count=12, bases=3, sigma=REGIMES["typical"], spread=5.0, pixel=PIXEL):
    """Centres, log-scales, quaternions, coefficients in float64; `sigma` in units of `pixel`, `spread` in mm."""
    rng = np.random.default_rng(seed)
    scales = pixel * np.exp(rng.uniform(*np.log(sigma), (count, 3)))
    parts = (
        rng.uniform(-spread, spread, (count, 3)),
        np.log(scales),
        rng.normal(size=(count, 4)),
        rng.uniform(0.1, 1.0, (count, bases)),
    )
    return tuple(torch.from_numpy(part) for part in parts)


def one_gaussian(centre, sigma, bases=1, dtype=torch.float64):
    """One upright Gaussian with coefficients 1; `sigma` may be one number or three [mm]."""
    scales = torch.tensor(sigma, dtype=dtype).log().expand(1, 3).contiguous()
    turn = torch.tensor([[1.0, 0, 0, 0]], dtype=dtype)
    return torch.tensor([centre], dtype=dtype), scales, turn, torch.ones(1, bases, dtype=dtype)


def circular(rows=13, columns=16, views=3, pitch=PITCH):
    angles = 0.2 + np.arange(views) * 2 * np.pi / views
    return Geometry.circular(SOD, SDD, angles, Panel(rows, columns, pitch))


def tilted(rows=14, columns=11, views=2, seed=5):
    """Free poses: panels shifted by up to three pixels, tilted by some ten degrees, with oblong pixels."""
    rng = np.random.default_rng(seed)
    base = circular(rows, columns, views, (PITCH, 1.2 * PITCH))
    names = {"source": 3.0, "panel_center": 2 * PITCH, "column_step": 0.2, "row_step": 0.2}
    moved = [getattr(base, name) + rng.normal(scale=size, size=(views, 3)) for name, size in names.items()]
    return Geometry(*moved, base.panel)


GEOMETRIES = {"odd-even": circular(13, 16), "even-odd": circular(18, 9, views=2), "tilted": tilted()}


def frames_of(geometry):
    return torch.from_numpy(geometry.ray_frames())


def spectral_model(bases=3, channels=4, photons=1e5):
    """Few nodes per channel, columns that fall, fall slowly, and jump: well-conditioned, cheap, nothing physical."""
    energy = np.linspace(25, 115, 4 * channels)
    columns = np.stack([(70 / energy) ** 3, (70 / energy) ** 0.3, np.where(energy > 63, (70 / energy) ** 3, 0.02)])
    weights = np.full(len(energy), photons / len(energy))
    return Transmission(columns[:bases], weights, 4 * np.arange(channels + 1))


def small_scan(truth, geometry, model, seed=None):
    """Measurements of Gaussians: expected counts, or Poisson counts with a seed."""
    panel = geometry.panel
    lengths = np.moveaxis(truth.line_integrals(geometry).numpy().astype(float), 1, -1)
    counts = np.moveaxis(model.expected(lengths), -1, 1)
    if seed is not None:
        counts = np.random.default_rng(seed).poisson(counts)
    gains = np.ones((len(model), panel.rows, panel.columns), np.float32)
    return Measurements(counts.astype(np.float32), gains, np.ones(counts.shape[:2]), geometry, model, truth.basis_names)


def small_model(seed, count=50, bases=3, spread=6.0, height=0.02):
    """A `Gaussians` in float32 with coefficients [1/mm] that let photons through."""
    centres, scales, turns, values = (p.float() for p in random_gaussians(seed, count, bases, spread=spread))
    return Gaussians(centres, scales, turns, values * height, NAMES[:bases])
