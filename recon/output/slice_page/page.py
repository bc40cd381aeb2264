"""The page: volumes, basis functions and the program that draws them, in one HTML file."""

import base64
import gzip
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from phantomgen.geometry.voxel_grid import Grid
from recon.readouts.readouts import Readouts
from spectra.basis.basis import pretty

LARGEST = 16_000_000  # values of all volumes; more are binned, as a page of them takes about 30 MB; chosen by hand
LEVELS = 65535  # steps between the least and the largest value of a volume, in 16 bits
ENERGY = 70.0  # keV; of the image at one energy that is shown first, where the spectrum has it

Volumes = Float[np.ndarray, "basis z y x"]


@dataclass(frozen=True, eq=False)
class SliceContent:
    """What a page of slices shows.

    Parameters
    ----------
    name : of the run
    grid : voxels of all volumes
    basis_names : of the basis functions, the first ones of `readouts`
    volumes : coefficients of the ``result``, and of the ``truth`` where it is known [1/mm]
    readouts : conversion to other quantities
    """

    name: str
    grid: Grid
    basis_names: tuple[str, ...]
    volumes: dict[str, Volumes]
    readouts: Readouts

    def binned(self) -> tuple["SliceContent", int]:
        """Average blocks of voxels until all volumes together have at most `LARGEST` values.

        Returns
        -------
        the content, and the voxels along each edge of a block
        """
        factor, shape = 1, self.grid.shape
        while sum(len(v) for v in self.volumes.values()) * np.prod([n // factor for n in shape]) > LARGEST:
            factor += 1
        if factor == 1:
            return self, 1
        few = tuple(n // factor for n in shape)
        spacing = tuple(s * factor for s in self.grid.spacing)
        origin = tuple(o + (factor - 1) / 2 * s for o, s in zip(self.grid.origin, self.grid.spacing, strict=True))
        volumes = {kind: _block_means(values, few, factor) for kind, values in self.volumes.items()}
        grid = Grid(few, spacing, origin)  # type: ignore[arg-type]
        return SliceContent(self.name, grid, self.basis_names, volumes, self.readouts), factor


def slice_page(content: SliceContent) -> str:
    """Create a page of slices.

    Parameters
    ----------
    content : what is shown

    Returns
    -------
    HTML
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined  # noqa: PLC0415 - only where a page is written

    few, factor = content.binned()
    environment = Environment(
        loader=PackageLoader("recon.output.slice_page", ""), autoescape=True, undefined=StrictUndefined
    )
    script = (Path(__file__).parent / "slices.js").read_text(encoding="utf-8")
    data = json.dumps(embedded(few), separators=(",", ":")).replace("<", "\\u003c")
    return environment.get_template("page.html.j2").render(
        title=content.name,
        choices=len(content.basis_names) + 1,
        about=_about(few, factor),
        data=data,
        script=script,
    )


def embedded(content: SliceContent) -> dict[str, Any]:
    """Convert the content to plain values, as `slices.js` reads them.

    Parameters
    ----------
    content : what is shown

    Returns
    -------
    values that JSON holds; axes in the order z, y, x
    """
    readouts, count = content.readouts, len(content.basis_names)
    low, high = readouts.span
    energies = np.arange(np.ceil(low), np.floor(high) + 1)
    curves = readouts.basis.evaluate(energies)
    return {
        "shape": list(content.grid.shape),
        "spacing": list(content.grid.spacing),
        "origin": list(content.grid.origin),
        "bases": [pretty(name) for name in content.basis_names],
        "energies": energies.tolist(),
        "start": int(np.abs(energies - ENERGY).argmin()),
        "curves": curves[:count].tolist(),
        "water": (readouts.water @ curves).tolist(),
        "agents": [
            {"element": element, "amounts": agent.amounts[:count].tolist()}
            for element, agent in readouts.agents.items()
        ],
        "volumes": {kind: [stored(volume) for volume in volumes] for kind, volumes in content.volumes.items()},
    }


def stored(volume: Float[np.ndarray, "z y x"]) -> dict[str, Any]:
    """Quantise a volume to 16 bits.

    Parameters
    ----------
    volume : values

    Returns
    -------
    ``offset``, ``step`` and ``data``, gzip-compressed numbers in base64: values are offset + step x number, within half
    a step
    """
    low, high = float(volume.min()), float(volume.max())
    step = (high - low) / LEVELS or 1.0
    numbers = np.rint((volume.astype(np.float64) - low) / step).astype("<u2")
    packed = gzip.compress(np.ascontiguousarray(numbers).tobytes(), compresslevel=6, mtime=0)
    return {"offset": low, "step": step, "data": base64.b64encode(packed).decode("ascii")}


def _block_means(values: Volumes, few: tuple[int, ...], factor: int) -> Float[np.ndarray, "basis new_z new_y new_x"]:
    """Means of blocks of voxels; voxels beyond the last whole block are left out."""
    nz, ny, nx = (n * factor for n in few)
    blocks = values[:, :nz, :ny, :nx].reshape(len(values), few[0], factor, few[1], factor, few[2], factor)
    return blocks.mean(axis=(2, 4, 6))


def _about(content: SliceContent, factor: int) -> str:
    """Describe what the page holds, for its reader."""
    nz, ny, nx = content.grid.shape
    sizes = " x ".join(f"{s:.3g}" for s in content.grid.spacing[::-1])
    binned = f", means of {factor} x {factor} x {factor} voxels of the run" if factor > 1 else ""
    low, high = content.readouts.span
    return (
        f"The page holds {nx} x {ny} x {nz} voxels of {sizes} mm{binned}. Values are stored in 16 bits, within "
        f"{1 / (2 * LEVELS):.1g} of the range of each volume. Images at one energy follow from the basis functions, "
        f"from {low:.0f} to {high:.0f} keV, where the detected spectrum lies; 0 HU is water as the basis describes it."
    )
