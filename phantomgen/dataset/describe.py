"""Description of a dataset as numbers and as text."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from phantomgen.dataset.checks.door import find_array, find_group, group_at, has, value_at
from phantomgen.dataset.file import DARK, FLAT
from phantomgen.dataset.layout import text_of
from phantomgen.dataset.reader import Dataset, open_dataset
from phantomgen.dataset.truth import read_fit
from phantomgen.dataset.validate import newer_minor
from phantomgen.geometry.poses import distances

# What a step of the history is called when it is done; others are shown by their name.
_DONE = {"align": "aligned", "correct": "corrected", "degrade": "degraded", "import": "imported"}


def describe(path: Path) -> dict[str, Any]:
    """Describe the content of a dataset with values that JSON knows; ``warnings`` contains sentences.

    Parameters
    ----------
    path : the dataset

    Returns
    -------
    the description
    """
    anywhere = (slice(0, 1), slice(0, 1))  # a file without flats can be described, too
    with open_dataset(path, air=anywhere) as dataset:
        spectra, grid, panel = dataset.spectra, dataset.grid, dataset.geometry.panel
        newer = newer_minor(dataset)
        return {
            "file": str(path),
            "bytes": path.stat().st_size,
            "name": dataset.name,
            "shape": list(map(int, dataset.counts.shape)),
            "dtype": str(dataset.counts.dtype),
            "units": str(dataset.counts.attrs.get("units", "")),
            "pitch_mm": list(panel.pitch),  # type: ignore[arg-type]
            "orbit": dataset.geometry.kind,
            **distances(dataset.geometry),
            "channels": _channels(dataset),
            "counters": "cumulative" if dataset.subtracts else "bins",
            "dead_time": None if spectra.dead_time is None else asdict(spectra.dead_time),
            "pile_up": spectra.pulses is not None,
            "energies": len(spectra.energy),
            "range_keV": [float(spectra.edges[0]), float(spectra.edges[-1])],
            "photons": float(spectra.source.sum()),
            "profile": [] if spectra.profile is None else list(spectra.profile.names),
            "basis": list(spectra.basis.names),
            "time": _time(dataset),
            "views": {name: len(views) for name, views in dataset.splits.items()},
            "flats": _frames(dataset, FLAT),
            "darks": _frames(dataset, DARK),
            "masked_pixels": int(np.count_nonzero(dataset.mask.any(axis=0))),
            "grid": {"shape": list(grid.shape), "spacing_mm": list(grid.spacing), "origin_mm": list(grid.origin)},
            "truth": sorted(map(str, group_at(dataset.file, "truth"))) if has(dataset.file, "truth") else [],
            "materials": _materials(dataset),
            "nxtomo": sorted(name for name in map(str, dataset.file) if name.startswith("nxtomo_")),
            "made_by": _made_by(dataset),
            "history": _history(dataset),
            "warnings": [newer] if newer else [],
        }


def describe_text(info: dict[str, Any]) -> str:
    """Return the description of a dataset as text.

    Parameters
    ----------
    info : result of `describe`

    Returns
    -------
    lines of text
    """
    views, channels, rows, columns = info["shape"]
    what, unit = ("counts", "") if info["units"] == "counts" else ("signal", f" in {info['units']}")
    lines = [
        f"{info['file']}: {info['name']}, {info['bytes'] / 1e6:.1f} MB",
        f"{what:<10} {views} views x {channels} channels x {rows} x {columns} pixels, {info['dtype']}{unit}",
        f"views      {', '.join(f'{count} {name}' for name, count in info['views'].items())}",
        *_time_lines(info["time"]),
        f"frames     {info['flats']} flats, {info['darks']} darks",
        *_mask_lines(info["masked_pixels"], rows * columns),
        f"geometry   {info['orbit']}, {_distance_text(info)}, "
        f"pixels of {info['pitch_mm'][1]:g} x {info['pitch_mm'][0]:g} mm",
        f"channels   {', '.join('{name} {lower_keV:g}..{upper_keV:g} keV'.format(**c) for c in info['channels'])}",
        *_counter_lines(info["counters"]),
        *_dead_time_lines(info["dead_time"], info["pile_up"]),
        f"spectrum   {info['energies']} bins, {info['range_keV'][0]:g}..{info['range_keV'][1]:g} keV, "
        f"{info['photons']:g} photons per pixel and view"
        + (f"; differs over the panel: {', '.join(info['profile'])}" if info["profile"] else ""),
        f"basis      {', '.join(info['basis'])}",
        f"volume     {' x '.join(map(str, info['grid']['shape']))} voxels of "
        f"{' x '.join(f'{s:g}' for s in info['grid']['spacing_mm'])} mm (z, y, x)",
        f"truth      {', '.join(info['truth']) or 'none'}",
        *_material_lines(info["materials"]),
        f"NXtomo     {', '.join(info['nxtomo']) or _why_no_nxtomo(info)}",
        f"made by    {info['made_by']}",
        *(
            f"{_DONE.get(step['step'], step['step']):<10} {phrase}"
            for step in info["history"]
            for phrase in step["done"]
        ),
    ]
    return "\n".join(lines)


def _distance_text(info: dict[str, Any]) -> str:
    """Return the distances of a scan as text."""
    if info["sod_mm"] is None:
        return f"{info['object_to_panel_mm']:g} mm from axis to panel"
    return f"SOD {info['sod_mm']:g} mm, SDD {info['sdd_mm']:g} mm"


def _why_no_nxtomo(info: dict[str, Any]) -> str:
    """Why a file has no NXtomo entries."""
    return f"none: it knows {'rotation angles' if info['dtype'].startswith('int') else 'integer counts'} only"


def _channels(dataset: Dataset) -> list[dict[str, Any]]:
    """Name, limits and open-beam counts of each channel."""
    spectra = dataset.spectra
    counts = spectra.weights.sum(axis=1)
    return [
        {"name": name, "lower_keV": float(lower), "upper_keV": float(upper), "open_beam_counts": float(level)}
        for name, lower, upper, level in zip(spectra.channels, spectra.lower, spectra.upper, counts, strict=True)
    ]


def _materials(dataset: Dataset) -> dict[str, Any]:
    """Whose coefficients are explicit and whose are fitted, with window and error of the fit; empty without truth."""
    table = find_group(dataset.file, "truth/materials")
    if table is None or not has(table, "kind"):
        return {}
    names, kinds = ([text_of(t) for t in value_at(table, key)] for key in ("name", "kind"))
    fit = read_fit(table)
    if fit is None:
        return {"kind": dict(zip(names, kinds, strict=True))}
    errors = dict(zip(names, map(float, fit.errors), strict=True))
    return {
        "kind": dict(zip(names, kinds, strict=True)),
        "fit_error": {name: errors[name] for name, kind in zip(names, kinds, strict=True) if kind == "fitted"},
        "fit_window_keV": list(fit.window),
        "fit_weights": fit.weights,
    }


def _material_lines(materials: dict[str, Any]) -> list[str]:
    """Return the materials as lines of text."""
    explicit = [name for name, kind in materials.get("kind", {}).items() if kind == "explicit"]
    lines = [f"materials  {', '.join(explicit)}: explicit coefficients, for simulator and truth alike"]
    errors = materials.get("fit_error", {})
    if errors:
        low, high = materials["fit_window_keV"]
        each = ", ".join(f"{name} {error:.2%}" for name, error in errors.items())
        where = f"fitted over {low:g}..{high:g} keV, simulated exactly"
        lines.append(f"materials  {where}; rms relative error of the fit to mu(E): {each}")
    return lines[0 if explicit else 1 :]


def _mask_lines(masked: int, pixels: int) -> list[str]:
    """Masked pixels for people, where there are any."""
    return [f"mask       {masked} pixels do not measure, {masked / pixels:.2%}"] if masked else []


def _counter_lines(counters: str) -> list[str]:
    """Whether counters are cumulative, for people."""
    if counters == "bins":
        return []
    return ["counters   cumulative: the file has counts above each threshold, which are read as differences"]


def _dead_time_lines(dead_time: dict[str, Any] | None, pile_up: bool) -> list[str]:
    """Dead time for people, where there is any."""
    if dead_time is None:
        return []
    heights = "; heights of pulses add" if pile_up else ""
    return ["dead time  {tau_ns:g} ns per count, {exposure_ms:g} ms per view, {model}".format(**dead_time) + heights]


def _time(dataset: Dataset) -> dict[str, Any] | None:
    """Times of the views; None where the file states none."""
    times = dataset.view_times
    if times is None:
        return None
    span = [float(times.time.min(initial=0.0)), float(times.time.max(initial=0.0))]
    return {"range_s": span, "phases": times.phases, "cycles": list(times.cycles)}


def _time_lines(time: dict[str, Any] | None) -> list[str]:
    """Times of the views for people, where there are any."""
    if time is None:
        return []
    first, last = time["range_s"]
    divided = f", {time['phases']} phases" if time["phases"] > 1 else ""
    cycles = f"; cycles: {', '.join(time['cycles'])}" if time["cycles"] else ""
    return [f"time       {first:g} to {last:g} s{divided}{cycles}"]


def _frames(dataset: Dataset, name: str) -> int:
    """Number of flats or darks."""
    frames = find_array(dataset.file, name)
    return 0 if frames is None else int(frames.shape[0])


def _made_by(dataset: Dataset) -> str:
    """Program, version, date and seed of the first process."""
    entry = group_at(dataset.file, "entry")
    first = next((name for name in entry if str(name).startswith("process_1_")), "process_1_simulate")
    process = find_group(entry, str(first))
    if process is None:
        return "unknown"
    program, version, date = (text_of(value_at(process, name)) for name in ("program", "version", "date"))
    return f"{program} {version} on {date}, seed {int(value_at(process, 'seed'))}"


def _history(dataset: Dataset) -> list[dict[str, Any]]:
    """List what was done to the file after it was simulated, in order."""
    steps = []
    for name, group in group_at(dataset.file, "entry").items():
        if str(name).startswith("process_") and isinstance(group, h5py.Group) and "done" in group:
            number = int(value_at(group, "sequence_index"))
            done = [text_of(phrase) for phrase in value_at(group, "done")]
            what = str(name).split("_", 2)[2]
            steps.append({"number": number, "step": what, "seed": int(value_at(group, "seed")), "done": done})
    return sorted(steps, key=lambda step: step["number"])
