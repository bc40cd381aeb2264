"""The method of a run folder, from the settings that it states: the same reconstruction again."""

from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args, get_origin, get_type_hints

import yaml

from recon.gaussians.recipe import Recipe
from recon.published_methods.paper.recipe import PaperRecipe
from recon.runs.methods import METHODS, method_named
from recon.runs.run_gaussians import GaussianRun
from recon.runs.run_voxels import VoxelRun
from recon.voxel.method import ViewMethod
from spectra.errors import DatasetError, Error, InputError

if TYPE_CHECKING:
    from recon.runs.interfaces import RunMethod

RECIPE = "recipe.yaml"


def stored_method(folder: Path, bases: int) -> "RunMethod":
    """Return the method of a run with the settings of its ``recipe.yaml``.

    Parameters
    ----------
    folder : run folder
    bases : number of basis functions to reconstruct, the first ones of the dataset

    Returns
    -------
    the method

    Raises
    ------
    DatasetError
        When the file is missing, damaged, or of another version.
    InputError
        When the run has no method that reconstructs volumes, as one that scored a given volume.
    """
    path = folder / RECIPE
    try:
        settings = yaml.safe_load(path.read_text(encoding="utf-8"))
        name = settings.get("method")
    except (OSError, ValueError, AttributeError, yaml.YAMLError) as error:
        raise DatasetError(f"{path} cannot be read as the settings of a run ({error})") from None
    if name is not None and name not in METHODS:
        raise InputError(f"{folder} was not reconstructed by recon fit but holds a given {name}: there is no method")
    try:
        if name is not None:
            return _voxel_run(settings, bases)
        kind = PaperRecipe if "gaussians" in settings else Recipe
        return GaussianRun(_built(kind, settings), bases)
    except Error:
        raise
    except (TypeError, KeyError, ValueError) as error:
        raise DatasetError(
            f"{path} has other settings than this version of recon: run recon fit again ({error})"
        ) from None


def _voxel_run(settings: dict[str, Any], bases: int) -> VoxelRun:
    """Voxel method with its settings."""
    default = method_named(settings.pop("method"))
    if isinstance(default, ViewMethod):
        raise InputError("the run shows views and has no volumes: choose a run of another method")
    pipeline = {"pipeline": settings.pop("pipeline")} if "pipeline" in settings else {}
    return VoxelRun(_built(type(default), settings), bases=bases, **pipeline)


def _built(kind: type, settings: dict[str, Any]) -> Any:
    """Dataclass from the plain values that `dataclasses.asdict` and YAML made of it."""
    hints = get_type_hints(kind)
    missing = {field.name for field in fields(kind)} ^ set(settings)
    if missing:
        raise KeyError(", ".join(sorted(missing)))
    return kind(**{name: _value(hints[name], value) for name, value in settings.items()})


def _value(hint: Any, value: Any) -> Any:
    """Value of a field; lists become tuples, and mappings dataclasses."""
    kinds = [kind for kind in (hint, *get_args(hint)) if is_dataclass(kind) and isinstance(kind, type)]
    if kinds and isinstance(value, dict):
        return _built(kinds[0], value)
    if get_origin(hint) is tuple:
        inner = get_args(hint)
        each = [inner[0]] * len(value) if inner[-1] is Ellipsis else inner
        return tuple(_value(part, item) for part, item in zip(each, value, strict=True))
    return value
