"""Draws `docs/images/architecture.svg`: packages, their folders by layer, and who may import whom.

    python docs/development/draw_architecture.py

The layers are those of the import contracts in `pyproject.toml`, so that the picture cannot say anything else.
"""

import textwrap
import tomllib
from html import escape
from pathlib import Path

ROOT = Path(__file__).parents[2]
PICTURE = ROOT / "docs" / "images" / "architecture.svg"
TEXTS = {
    "recon.cli": "commands: parse, call, print",
    "recon.api": "short interface for Python",
    "recon.noise": "noise of a run, for Python",
    "recon.suite": "scores on a suite of scans",
    "recon.comparison": "methods at equal time",
    "recon.output": "files, report, viewer",
    "recon.callbacks": "bar, early stop",
    "recon.segmentation": "material maps",
    "recon.runs": "one whole run and its folder",
    "recon.calibration": "spectrum, thresholds",
    "recon.phases": "phases in time",
    "recon.figures": "figures of a run",
    "recon.evaluation": "scores, verdict",
    "recon.quality": "noise, resolution",
    "recon.kedge": "K edges in the counts",
    "recon.published_methods": "methods of other groups",
    "recon.gaussians": "the fit of Gaussians",
    "recon.voxel": "filtered and iterative methods on voxels",
    "recon.data": "from a dataset to what a fit takes",
    "recon.readouts": "CT numbers, electrons, agents",
    "recon.ops": "operators: rasterize, voxelize, likelihood, ...",
    "phantomgen.cli": "commands: parse, call, print",
    "phantomgen.api": "short interface for Python",
    "phantomgen.batch": "many scans",
    "phantomgen.suite": "fixed scans for results",
    "phantomgen.display": "viewer, figures, pages",
    "phantomgen.building": "scenes in Python",
    "phantomgen.warm_up": "kernels ahead",
    "phantomgen.analysis": "spectra, thresholds",
    "phantomgen.importers": "scans of others",
    "phantomgen.simulation": "plan, counts, checks",
    "phantomgen.scene": "from the YAML file to a scan",
    "phantomgen.dataset": "the HDF5 format",
    "phantomgen.shapes": "solids and meshes",
    "phantomgen.effects": "beam and detector",
    "phantomgen.exporters": "NIfTI, VTI",
    "phantomgen.volume_files": "volumes that come in",
    "phantomgen.ops": "trace, project, expected counts, ...",
    "phantomgen.geometry": "poses, orbits, grids",
    "phantomgen.runtime": "time, memory, versions",
    "spectra.channel_model": "channels of any voltage and threshold",
    "spectra.detector": "channels",
    "spectra.quadrature": "energy nodes by tolerance",
    "spectra.source": "tubes, lines, filters",
    "spectra.differentiable": "gradients",
    "spectra.materials": "compositions and densities",
    "spectra.basis": "basis functions",
    "spectra.transmission": "line integrals to expected counts",
    "spectra.elements": "tables of elements",
    "spectra.energy": "energy grids",
    "spectra.ops": "operators on arrays",
    "spectra.kernel_cache": "compiled kernels",
    "spectra.cramer_rao": "noise bounds",
    "spectra.threads": "threads",
    "spectra.errors": "messages for users",
}
COLOURS = {"recon": ("#e8f1fa", "#2b6cb0"), "phantomgen": ("#eaf5ea", "#2f7d32"), "spectra": ("#fbf1e3", "#b7600a")}
ROLES = {
    "recon": "reconstructs, scores, compares",
    "phantomgen": "describes, simulates, stores, shows",
    "spectra": "physics of energy: no space, no files",
}
ROW, GAP, HEAD, PAD = 42, 8, 34, 12
INK = "#1f2933"


def layers_of(package: str) -> list[list[str]]:
    """Modules of a package, layer by layer, the upper one first.

    Parameters
    ----------
    package : name of the package
    """
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"][
        "contracts"
    ]
    found = next(c["layers"] for c in contracts if c["type"] == "layers" and c.get("containers") == [package])
    return [[name.strip() for name in layer.split("|")] for layer in found]


def text(x: float, y: float, words: str, size: int = 12, weight: str = "normal", colour: str = INK) -> str:
    """A line of text, centred at a place."""
    return (
        f'<text x="{x:.0f}" y="{y:.0f}" font-size="{size}" font-weight="{weight}" fill="{colour}" '
        f'text-anchor="middle">{escape(words)}</text>'
    )


def arrow(x: float, y: float, to_x: float, to_y: float, colour: str = INK) -> str:
    """An arrow between two places."""
    return (
        f'<line x1="{x:.0f}" y1="{y:.0f}" x2="{to_x:.0f}" y2="{to_y:.0f}" stroke="{colour}" stroke-width="2" '
        'marker-end="url(#head)"/>'
    )


def height_of(package: str) -> int:
    """Height of the drawing of a package."""
    return HEAD + len(layers_of(package)) * (ROW + GAP) + PAD


def drawn(package: str, x: float, y: float, width: float) -> list[str]:
    """A package as a frame with a row of boxes per layer."""
    fill, line = COLOURS[package]
    out = [
        f'<rect x="{x:.0f}" y="{y:.0f}" width="{width:.0f}" height="{height_of(package)}" rx="8" fill="{fill}" '
        f'stroke="{line}" stroke-width="1.5"/>',
        f'<text x="{x + PAD:.0f}" y="{y + 23:.0f}" font-size="16" fill="{line}">'
        f'<tspan font-weight="bold">{package}</tspan>'
        f'<tspan font-size="12" dx="8">{escape(ROLES[package])}</tspan></text>',
    ]
    for i, names in enumerate(layers_of(package)):
        top = y + HEAD + i * (ROW + GAP)
        room = (width - 2 * PAD - GAP * (len(names) - 1)) / len(names)
        for j, name in enumerate(names):
            left = x + PAD + j * (room + GAP)
            lines = textwrap.wrap(TEXTS.get(f"{package}.{name}", ""), max(int(room / 5.6), 12))[:2]
            out.append(
                f'<rect x="{left:.0f}" y="{top:.0f}" width="{room:.0f}" height="{ROW}" rx="4" fill="white" '
                f'stroke="{line}" stroke-width="0.8"/>'
            )
            out.append(text(left + room / 2, top + (19 if len(lines) == 1 else 14), name, 12, "bold"))
            out += [
                text(left + room / 2, top + (33 if len(lines) == 1 else 26) + 11 * n, part, 10)
                for n, part in enumerate(lines)
            ]
    return out


def picture() -> str:
    """The drawing as SVG."""
    width, half, top = 1040, 480, 64
    below = top + max(height_of("recon"), height_of("phantomgen")) + 44
    total = below + height_of("spectra") + 34
    right = width - 10 - half
    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {total}" '
        'font-family="Helvetica, Arial, sans-serif" role="img" aria-label="Packages, folders and imports">',
        '<defs><marker id="head" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="7" markerHeight="7" orient="auto">'
        f'<path d="M0 0 L10 5 L0 10 z" fill="{INK}"/></marker></defs>',
        f'<rect width="{width}" height="{total}" fill="white"/>',
    ]
    for x, words, enters in (
        (90, "scene.yaml", True),
        (370, "dataset.h5", False),
        (650, "dataset.h5", True),
        (930, "run folder", False),
    ):
        out.append(text(x, 22, words, 12, "bold"))
        out.append(arrow(x, 28, x, top - 4) if enters else arrow(x, top - 4, x, 30))
    out += [
        arrow(412, 18, 608, 18),
        text(510, 12, "the fit reads counts only", 10),
        *drawn("phantomgen", 10, top, half),
        *drawn("recon", right, top, half),
        *drawn("spectra", 10, below, width - 20),
        arrow(right, top + HEAD + 6 * (ROW + GAP) + 21, 10 + half, top + HEAD + 6 * (ROW + GAP) + 21),
    ]
    for x, package in ((10 + half / 2, "phantomgen"), (right + half / 2, "recon")):
        out.append(arrow(x, top + height_of(package), x, below))
    note = (
        "Arrows between packages: may import. Inside a package a layer may import those below it, not its neighbours."
    )
    out.append(text(width / 2, total - 12, note, 12))
    return "\n".join([*out, "</svg>", ""])


if __name__ == "__main__":
    PICTURE.write_text(picture(), encoding="utf-8")
