"""Errors of the exact and of the local-affine projection of Gaussians, against quadrature along rays in float64.

    python -m benchmarks.operators.gaussian_projector

One Gaussian on the edge of a cone beam with a half-fan of 16, 34 or 45 degrees, round or elongated, turned eight ways;
pixels sample rays, so that nothing but the projection differs. Errors are over the peak of the line integral: the
worst of all pixels, and of the sum over the panel. A half-fan of 16 degrees is that of a common micro-CT, 34 degrees
that of a full-fan C-arm seen from its edges. Prints, and writes to results/projector_error.txt beside this file.
"""

from pathlib import Path

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from phantomgen.geometry.panel import Panel
from phantomgen.geometry.poses import Geometry
from recon.ops.rasterize import FARTHEST, PROJECTORS, Projector, rasterize
from spectra.threads import set_threads

SOD, SDD, PIXELS = 500.0, 1000.0, 81
SHAPES = {
    "round, 1 mm": (1, 1, 1), "round, 8 mm": (8, 8, 8), "3 : 1 : 1": (6, 2, 2),
    "10 : 1 : 1": (10, 1, 1), "disc 10 : 10 : 1": (10, 10, 1),
}  # fmt: skip
TURNS = Rotation.random(8, np.random.default_rng(1))
NODES, WEIGHTS = np.polynomial.legendre.leggauss(64)


def scene(half_fan: float, scales: tuple[float, float, float], turn: Rotation) -> tuple[list[torch.Tensor], np.ndarray]:
    """A Gaussian on the edge of the fan, and the frame of a panel of pixels about its shadow, 5 deviations wide."""
    angle = np.deg2rad(half_fan)
    centre = np.array([SOD - SOD * np.cos(angle) ** 2, -SOD * np.sin(angle) * np.cos(angle), 0.0])
    pitch = 2.4 * 5 * max(scales) * SDD / (SOD * np.cos(angle) ** 3) / PIXELS
    view = Geometry.circular(SOD, SDD, np.zeros(1), Panel(PIXELS, PIXELS, pitch)).ray_frames()[0]
    shadow = np.linalg.solve(np.stack([view[2], view[3], view[1]], 1), centre - view[0])
    middle = shadow[:2] / shadow[2] - (PIXELS - 1) / 2
    view[1] += middle[0] * view[2] + middle[1] * view[3]
    w = np.roll(turn.as_quat(), 1)
    parts = [torch.tensor(np.array([x]), dtype=torch.float64) for x in (centre, np.log(scales), w, (1.0,))]
    return parts, view


def quadrature(parts: list[torch.Tensor], frame: np.ndarray) -> np.ndarray:
    """Gauss-Legendre rule over 8 standard deviations about the closest point of each ray."""
    centre, log_scales, quaternion, _ = (part[0].numpy() for part in parts)
    whitening = np.exp(-log_scales)[:, None] * Rotation.from_quat(np.roll(quaternion, -1)).as_matrix().T
    steps = np.arange(PIXELS)
    d = frame[1] + steps[:, None] * frame[2] + steps[:, None, None] * frame[3]
    u, v = whitening @ (centre - frame[0]), d @ whitening.T
    length = np.linalg.norm(v, axis=-1)
    nearest, total = v @ u / length**2, np.zeros(d.shape[:2])
    for node, weight in zip(NODES, WEIGHTS, strict=True):
        at = u - (nearest + 8 * node / length)[..., None] * v
        total += 8 * weight / length * np.exp(-0.5 * (at * at).sum(-1))
    return total * np.linalg.norm(d, axis=-1)


def errors(half_fan: float, scales: tuple[float, float, float]) -> dict[str, tuple[float, float]]:
    """Worst error over the peak, and worst error of the sum, of each projector."""
    worst: dict[str, tuple[float, float]] = dict.fromkeys(PROJECTORS, (0.0, 0.0))
    for turn in TURNS:
        parts, frame = scene(half_fan, scales, turn)
        truth = quadrature(parts, frame)
        for name in PROJECTORS:
            view = torch.from_numpy(frame[None]), PIXELS, PIXELS
            image = rasterize(*parts, *view, Projector(0.0, FARTHEST, name))[0, 0].numpy()
            pixel, total = abs(image - truth).max() / truth.max(), abs(image.sum() / truth.sum() - 1)
            worst[name] = (max(worst[name][0], pixel), max(worst[name][1], total))
    return worst


def main() -> None:
    set_threads(1)
    head = (
        f"{'half-fan':>10s}  {'Gaussian':18s}{'exact: pixel':>14s}{'sum':>10s}{'local-affine: pixel':>22s}{'sum':>10s}"
    )
    lines = [f"kernel in float32, cut off at {FARTHEST:g} standard deviations; errors over the peak", head]
    for half_fan in (16.0, 34.0, 45.0):
        for name, scales in SHAPES.items():
            (pixel, total), (affine_pixel, affine_total) = errors(half_fan, scales).values()
            lines.append(
                f"{half_fan:10.0f}  {name:18s}{pixel:14.1e}{total:10.1e}{affine_pixel:22.1e}{affine_total:10.1e}"
            )
    text = "\n".join(lines) + "\n"
    print(text)
    (Path(__file__).parents[1] / "results" / "gaussian_projector.txt").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
