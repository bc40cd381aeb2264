"""TIFF files with a YAML file that says where the views are: ``geometry`` and ``panel`` as in scene files."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
import yaml
from pydantic import BaseModel, ConfigDict, Field, PositiveFloat, ValidationError

from phantomgen.geometry.config import read_geometry_file
from phantomgen.importers.files.images import Stack, tiff_stack, tiffs_like
from phantomgen.importers.scans.raw_scan import Frames, Image, RawScan
from phantomgen.importers.scans.stated import Stated
from spectra.errors import InputError

_CHANNEL = "{channel}"


class _Model(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class _Beam(_Model):
    """Facts about beam and detector, named like the options that state them."""

    kvp: PositiveFloat | None = None
    filter: str | None = None
    energy: PositiveFloat | None = None
    spectrum: str | None = None
    thresholds: tuple[PositiveFloat, ...] | None = None
    scintillator: str | None = None
    photons: PositiveFloat | None = None


class _File(_Model):
    """All keys of the file; those of geometry and panel are checked where they are read."""

    title: str | None = None
    geometry: Any
    panel: Any
    values: Literal["counts", "readings", "line-integrals"]
    views: str
    channels: tuple[str, ...] = Field(default=("signal",), min_length=1)
    flats: str | None = None
    darks: str | None = None
    exposure: tuple[PositiveFloat, ...] | None = None
    beam: _Beam = _Beam()


def read(paths: Sequence[Path], stated: Stated) -> RawScan:
    """Read a scan.

    Parameters
    ----------
    paths : one YAML file
    stated : facts that the user states

    Returns
    -------
    the scan

    Raises
    ------
    InputError
        When a file is missing or damaged, or a key is wrong.
    """
    path = paths[0]
    geometry = read_geometry_file(path)
    file = _checked(path)
    panel = geometry.panel
    shape = panel.rows, panel.columns
    patterns = {name: getattr(file, name) for name in ("views", "flats", "darks")}
    for name, pattern in patterns.items():
        if pattern is not None and (_CHANNEL in pattern) != (len(file.channels) > 1):
            raise InputError(f"{path}: {name} must name the folder or file of each of several channels by {_CHANNEL}")
    stacks = {name: _stacks(path, pattern, file.channels, shape) for name, pattern in patterns.items() if pattern}
    for channel, stack in zip(file.channels, stacks["views"], strict=True):
        if len(stack) != len(geometry):
            raise InputError(f"{path}: channel {channel} has {len(stack)} images, the geometry {len(geometry)} views")
    exposure = None
    if file.exposure is not None:
        if len(file.exposure) != len(geometry):
            raise InputError(f"{path}: exposure has {len(file.exposure)} values for {len(geometry)} views")
        exposure = np.repeat(np.array(file.exposure)[:, None], len(file.channels), axis=1)
    beam = file.beam.model_dump()
    beam["filters"] = beam.pop("filter")
    beam["spectrum"] = None if beam["spectrum"] is None else path.parent / beam["spectrum"]

    def image(view: int) -> Image:
        return np.stack([stack[view] for stack in stacks["views"]])

    return RawScan(
        path=path,
        title=file.title or path.stem,
        values=file.values,
        channels=file.channels,
        geometry=geometry,
        image=image,
        stated=stated.completed(beam),
        flats=_frames(stacks.get("flats")),
        darks=_frames(stacks.get("darks")),
        exposure=exposure,
    )


def _checked(path: Path) -> _File:
    """The keys of the file; `read_geometry_file` has read it as YAML."""
    try:
        return _File.model_validate(yaml.safe_load(path.read_text(encoding="utf-8")))
    except ValidationError as error:
        first = min(error.errors(), key=lambda one: one["type"] != "extra_forbidden")
        key = ".".join(str(part) for part in first["loc"])
        said = {"extra_forbidden": "is an unknown key", "missing": "is missing"}
        text = said.get(first["type"], f"- {first['msg'][0].lower()}{first['msg'][1:]}")
        raise InputError(f"{path}: {key} {text}") from None


def _stacks(path: Path, pattern: str, channels: Sequence[str], shape: tuple[int, int]) -> list[Stack]:
    """Images of each channel."""
    return [tiff_stack(tiffs_like(path, pattern.replace(_CHANNEL, name)), shape) for name in channels]


def _frames(stacks: list[Stack] | None) -> Frames | None:
    """All frames of all channels; as many of each as the shortest stack has."""
    if stacks is None:
        return None
    count = min(map(len, stacks))
    return np.stack([stack.all()[:count] for stack in stacks], axis=1)
