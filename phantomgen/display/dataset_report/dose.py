"""Parts of the page about dose: CTDI, the dose of each material, and a map."""

from pathlib import Path

from phantomgen.dataset.truth import Truth
from phantomgen.display.figures.dose import write_figure
from phantomgen.display.html import Paragraph, Part, Table, picture
from phantomgen.dose.report import DoseReport
from phantomgen.scene.file.scene_file import SceneFile
from phantomgen.scene.scan import load_scene

PHOTONS, VOXELS = 300_000, 48  # of the map, and for each cylinder; a few seconds


def dose_parts(path: Path, truth: Truth, folder: Path, progress: bool = False) -> list[Part]:
    """Compute the dose of the scan that a dataset was simulated from.

    Parameters
    ----------
    path : of the dataset; files that its scene names are looked for beside it
    truth : with the scene as text
    folder : folder for the picture
    progress : show bars on stderr

    Returns
    -------
    parts of the page

    Raises
    ------
    InputError
        When the scene cannot be read, or its dose not be computed.
    """
    report = DoseReport.of(load_scene(SceneFile(str(path), truth.scene)), PHOTONS, VOXELS, progress=progress)
    rows = [("air kerma at the isocentre, nothing in the beam", _milligray(report.kerma), "")]
    for each in report.ctdi:
        where = f"CTDIvol in {each.diameter / 10:g} cm of PMMA"
        rows.append((where, _milligray(each.volume), f"{100 * each.error:.1f} %"))
    if report.map is not None:
        rows += [(f"mean dose of {name}", _milligray(dose), "") for name, (dose, _) in report.map.materials.items()]
    caption = "Dose of all views, test views included, by Monte Carlo with all orders of scattering."
    parts: list[Part] = [Table(("quantity", "dose [mGy]", "standard error"), tuple(rows), caption, "dose")]
    if report.map is not None:
        write_figure(report.map, report.name, folder / "dose.svg")
        error = f"standard error of a typical voxel {100 * report.map.typical_error:.0f} %"
        parts.append(
            picture(folder / "dose.svg", f"Dose in three planes; {error}. `phantomgen dose` computes more photons.")
        )
    return parts + [Paragraph(f"Not computed: {sentence}.") for sentence in report.missing]


def _milligray(dose: float) -> str:
    return f"{1e3 * dose:.3g}"
