"""Calibration files: what is known of a scanner, and counts behind known absorbers, in YAML and CSV."""

import csv
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, ConfigDict, Field, NonNegativeFloat, PositiveFloat, ValidationError, model_validator

from phantomgen.runtime.yaml_text import YamlTextError, parse_yaml
from recon.calibration.step_wedge import StepWedge, WedgeModel
from spectra.channel_model import ChannelModel, Tube
from spectra.elements.attenuation import natural_density
from spectra.errors import InputError
from spectra.materials.material import Material
from spectra.source.source import Filter

# Room above the stated voltage in which it is sought [kV], and below the lowest threshold in resolutions.
_ROOM, _REACH = 20.0, 3.0
_LOWEST = 2.0  # keV

Composition = str | dict[str, float]
Parameter = Literal["voltage", "filter", "thresholds", "resolution"]


class _Model(BaseModel):
    """Part of a calibration file."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class MaterialModel(_Model):
    """Material by composition and density [g/cm^3], which may be left out for elements and named materials."""

    composition: Composition
    density: PositiveFloat | None = None


class FilterModel(MaterialModel):
    """Flat filter with its thickness [mm]."""

    thickness: NonNegativeFloat


class SourceModel(_Model):
    """Tube: voltage [kV], anode angle [degree], the filter to be found, and those that are known."""

    voltage: PositiveFloat
    filter: FilterModel
    known_filters: tuple[FilterModel, ...] = ()
    anode: str = "tungsten"
    angle: PositiveFloat = 12.0


class DetectorModel(_Model):
    """Counting detector: thresholds [keV], resolution (full width at half maximum [keV]), and sensor [mm]."""

    thresholds: tuple[PositiveFloat, ...] = Field(min_length=1)
    resolution: NonNegativeFloat = 0.0
    composition: Composition = "CdTe"
    density: PositiveFloat | None = None
    thickness: PositiveFloat = 1.6
    fluorescence: bool = False


class StepModel(_Model):
    """Counts of all channels behind absorbers, whose thicknesses [mm] go by the material's name."""

    lengths: dict[str, NonNegativeFloat] = {}
    counts: tuple[NonNegativeFloat, ...]


class CalibrationModel(_Model):
    """A calibration file."""

    version: Literal[1]
    source: SourceModel
    detector: DetectorModel
    free: tuple[Parameter, ...] = Field(("voltage", "filter", "thresholds"), min_length=1)
    prior: dict[Parameter, PositiveFloat] = {}
    common_gain: bool = False
    open_beam: tuple[PositiveFloat, ...] | None = None
    materials: dict[str, MaterialModel] = {}
    table: str | None = None
    steps: tuple[StepModel, ...] = ()

    @model_validator(mode="after")
    def _has_counts_once(self) -> "CalibrationModel":
        if bool(self.table) == bool(self.steps):
            raise ValueError("give either a table, the name of a CSV file, or steps")
        return self


def read_calibration(
    path: Path, free: tuple[str, ...] = (), prior: dict[str, float] | None = None
) -> tuple[WedgeModel, Float[np.ndarray, " parameter"]]:
    """Read a calibration file with its table.

    Parameters
    ----------
    path : YAML file
    free : parameters to estimate in place of those of the file: ``voltage``, ``filter``, ``thresholds``, ``resolution``
    prior : standard deviations of priors that replace or add to those of the file

    Returns
    -------
    the model of the counts, and the standard deviation of the prior of each free parameter, infinite for none

    Raises
    ------
    InputError
        When the file cannot be read, lacks a key, or has one that does not belong there.
    """
    values = _yaml(path)
    if free:
        values["free"] = list(free)
    if prior:
        values["prior"] = {**(values.get("prior") or {}), **prior}
    try:
        model = CalibrationModel.model_validate(values)
    except ValidationError as error:
        raise InputError(f"{path}: {_sentence(error)}") from None
    try:
        return _wedge_model(model, path.parent)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _wedge_model(model: CalibrationModel, folder: Path) -> tuple[WedgeModel, Float[np.ndarray, " parameter"]]:
    """Model and priors of the checked content of a file."""
    channels = len(model.detector.thresholds)
    steps = _table(folder / model.table, channels) if model.table else [(s.lengths, s.counts) for s in model.steps]
    for number, (_, counts) in enumerate(steps):
        if len(counts) != channels:
            raise InputError(f"steps.{number}.counts has {len(counts)} values for {channels} thresholds")
    if model.open_beam is not None:
        steps = _of_transmission(steps, np.array(model.open_beam), channels)
    names = list(dict.fromkeys(name for lengths, _ in steps for name, length in lengths.items() if length > 0))
    if not names:
        raise InputError("no step has an absorber: name materials with thicknesses in mm")
    materials = tuple(_material(name, model.materials.get(name)) for name in names)
    lengths = np.array([[float(lengths.get(name, 0.0)) for name in names] for lengths, _ in steps])
    wedge = StepWedge(materials, lengths, np.array([c for _, c in steps], dtype=np.float64), model.common_gain)
    start = np.array(
        [
            model.source.voltage,
            model.source.filter.thickness,
            *model.detector.thresholds,
            model.detector.resolution,
        ]
    )
    kinds = ["voltage", "filter", *["thresholds"] * channels, "resolution"]
    free = np.array([kind in model.free for kind in kinds])
    unused = [kind for kind in model.prior if kind not in model.free]
    if unused:
        raise InputError(f"prior.{unused[0]} has no use, as {unused[0]} is not free: add it to 'free', or leave it out")
    prior = np.array([model.prior.get(kind, np.inf) for kind, f in zip(kinds, free, strict=True) if f])  # type: ignore[arg-type]
    return WedgeModel(_channel_model(model, materials), wedge, start, free), prior


def _channel_model(model: CalibrationModel, absorbers: tuple[Material, ...]) -> ChannelModel:
    """Sensitivities of the channels on a grid with room for what is sought."""
    source, detector = model.source, model.detector
    known = tuple(Filter(_material(str(f.composition), f), f.thickness) for f in source.known_filters)
    tube = Tube(source.anode, source.angle, known)
    sensor = Material(str(detector.composition), detector.density, detector.composition)
    sheet = _material(str(source.filter.composition), source.filter)
    low = max(min(detector.thresholds) - 5.0 - _REACH * max(detector.resolution, 1.0) / 2, _LOWEST)
    materials = (sheet, sensor, *(f.material for f in known), *absorbers)
    grid = ChannelModel.grid(tube, materials, low, source.voltage + _ROOM)
    return ChannelModel(tube, sheet, sensor, detector.thickness, grid, detector.fluorescence)


def _material(name: str, model: MaterialModel | None) -> Material:
    """A material that the file defines, or an element or named material."""
    if model is not None:
        return Material(name, model.density, model.composition)
    if natural_density(name) is None:
        raise InputError(f"the material {name!r} needs an entry in 'materials' with composition and density [g/cm^3]")
    return Material(name, None, name)


def _of_transmission(
    steps: list[tuple[dict[str, float], tuple[float, ...]]], open_beam: Float[np.ndarray, " channel"], channels: int
) -> list[tuple[dict[str, float], tuple[float, ...]]]:
    """Counts from transmissions and the open beam that they were divided by, which is a step without absorber."""
    if len(open_beam) != channels:
        raise InputError(f"open_beam has {len(open_beam)} values for {channels} thresholds")
    if any(max(values) > 1.2 for _, values in steps):
        raise InputError("with open_beam, the steps give transmissions, but a value is above 1.2: leave out open_beam")
    behind = [(lengths, tuple(np.array(v) * open_beam)) for lengths, v in steps if any(lengths.values())]
    return [({}, tuple(open_beam)), *behind]


def _table(path: Path, channels: int) -> list[tuple[dict[str, float], tuple[float, ...]]]:
    """Steps of a CSV file: material, thickness [mm], then the counts of each channel."""
    try:
        with path.open(encoding="utf-8", newline="") as file:
            rows = [row for row in csv.reader(file) if row and not row[0].lstrip().startswith("#")]
    except OSError as error:
        raise InputError(f"table: {path} cannot be read: {error.strerror}") from None
    except (UnicodeDecodeError, csv.Error):
        raise InputError(f"table: {path} is no CSV text") from None
    if not rows or [cell.strip() for cell in rows[0][:2]] != ["material", "thickness"]:
        raise InputError(f"table: the first line of {path} must read material,thickness, and a name for each channel")
    steps = []
    for number, row in enumerate(rows[1:], start=2):
        try:
            material, thickness, *counts = row[0].strip(), float(row[1] or 0), *(float(cell) for cell in row[2:])
        except (ValueError, IndexError):
            raise InputError(f"table: line {number} of {path} needs a material, a thickness and counts") from None
        if len(counts) != channels:
            raise InputError(f"table: line {number} of {path} has {len(counts)} counts for {channels} thresholds")
        steps.append(({material: thickness} if thickness else {}, tuple(counts)))
    return steps


def _yaml(path: Path) -> dict[str, Any]:
    """Keys and values of a file."""
    try:
        values = parse_yaml(path.read_text(encoding="utf-8")).values
    except OSError as error:
        raise InputError(f"{path} cannot be read as a calibration: {error.strerror}") from None
    except YamlTextError as problem:
        raise InputError(f"{path}:{problem.line}:{problem.column}: {problem.reason}") from None
    except UnicodeDecodeError:
        raise InputError(f"{path} is no YAML: it is not UTF-8 text") from None
    if not isinstance(values, dict):
        raise InputError(f"{path}: a calibration is a mapping of keys to values that starts with 'version: 1'")
    return dict(values)


def _sentence(error: ValidationError) -> str:
    """Say what is wrong first, with its key."""
    found = error.errors()[0]
    key = ".".join(map(str, found["loc"]))
    message = found["msg"].removeprefix("Value error, ")
    text = "unknown key" if found["type"] == "extra_forbidden" else message[0].lower() + message[1:]
    got = "" if found["type"] in {"missing", "extra_forbidden", "value_error"} else f", got {found['input']!r}"
    return f"{key}{' - ' if key else ''}{text}{got}"
