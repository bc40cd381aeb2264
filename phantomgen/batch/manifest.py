"""Manifest of a batch: a scene or preset, its overrides, and seeds; item i is the scene of seed `seed` + i."""

import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from phantomgen.dataset.compression import Compression, check_compression
from phantomgen.runtime.yaml_text import YamlTextError, parse_yaml
from phantomgen.scene.file.scene_file import SceneFile
from phantomgen.simulation.forward_model.fingerprint import digest
from spectra.errors import InputError, SceneError

# A manifest is refused when so many items that follow each other are no scenes: then it is hardly a matter of luck.
_TRIED = 3
_OF_A_SCENE = {"source", "detector", "geometry", "objects"}  # keys that no manifest has


class BatchModel(BaseModel):
    """A manifest."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    version: Literal[1]
    preset: str | None = Field(None, description="name of a scene that comes with the program")
    scene: str | None = Field(None, description="scene file, relative to the manifest")
    set: dict[str, Any] = Field({}, description="values that override those of the scene, by dotted paths")
    seed: int = Field(0, ge=0, description="seed of item 0")
    count: int = Field(1, ge=1, description="number of items")
    keep: tuple[Literal["expected"], ...] = ()
    compression: Compression = "gzip"

    @model_validator(mode="after")
    def _has_one_scene(self) -> "BatchModel":
        if (self.preset is None) == (self.scene is None):
            raise ValueError("name either a preset or a scene")
        return self


@dataclass(frozen=True)
class Item:
    """Item of a batch: everything that a worker requires to make one dataset.

    Parameters
    ----------
    number : in the batch
    seed : of the scene
    file : the scene, with its overrides
    path : of the dataset
    keep_expected, compression : of `simulate`
    """

    number: int
    seed: int
    file: SceneFile
    path: Path
    keep_expected: bool
    compression: Compression


@dataclass(frozen=True)
class Batch:
    """Batch from a manifest.

    Parameters
    ----------
    name : of its file
    model : what it says
    scene : the scene of all items, without seeds
    """

    name: str
    model: BatchModel
    scene: SceneFile

    @classmethod
    def read(cls, path: Path | str) -> "Batch":
        """Read a manifest from a YAML file.

        Parameters
        ----------
        path : the file

        Returns
        -------
        the batch

        Raises
        ------
        InputError, SceneError
            When it is no manifest, or its first items are no scenes.
        """
        path = Path(path)
        model = _model(path)
        check_compression(model.compression)
        overrides = [f"{key}={json.dumps(value, default=str)}" for key, value in model.set.items()]
        if model.preset is not None:
            scene = SceneFile.preset(model.preset, overrides)
        else:
            scene = SceneFile.read(path.parent.absolute() / str(model.scene), overrides)
        batch = cls(str(path), model, scene)
        batch._check_scenes()
        return batch

    @cached_property
    def recipe(self) -> str:
        """Digest of what items are made of; it does not depend on how many there are."""
        said = self.model.model_dump(exclude={"count", "scene"})
        return digest((self.scene.text, self.scene.overrides, repr(sorted(said.items()))))

    def item(self, number: int, folder: Path) -> Item:
        """Return one item.

        Parameters
        ----------
        number : of the item
        folder : folder of the datasets

        Returns
        -------
        the item
        """
        model, seed = self.model, self.model.seed + number
        file = SceneFile(self.scene.name, self.scene.text, (*self.scene.overrides, f"seed={seed}"))
        path = folder / f"item{number:06d}.h5"
        return Item(number, seed, file, path, "expected" in model.keep, model.compression)

    def _check_scenes(self) -> None:
        """Refuse a manifest whose first items are all wrong; later ones fail one by one."""
        for left in reversed(range(min(_TRIED, self.model.count))):
            try:
                _ = self.item(left, Path()).file.model
            except SceneError:
                if left == 0:
                    raise
            else:
                return


def _model(path: Path) -> BatchModel:
    """The checked content of a manifest."""
    try:
        values = parse_yaml(path.read_text(encoding="utf-8")).values
    except OSError as error:
        raise InputError(f"{path} cannot be read as a manifest: {error.strerror}") from None
    except YamlTextError as problem:
        raise InputError(f"{path}:{problem.line}:{problem.column}: {problem.reason}") from None
    except UnicodeDecodeError:
        raise InputError(f"{path} is no YAML: it is not UTF-8 text") from None
    if not isinstance(values, dict):
        raise InputError(f"{path}: a manifest is a mapping of keys to values that starts with 'version: 1'")
    if values.keys() & _OF_A_SCENE and not values.keys() & {"preset", "scene"}:
        raise InputError(
            f"{path} is a scene and no manifest of a batch: `phantomgen make {path}` makes one dataset of it, and a "
            f"manifest that says {{version: 1, scene: {path.name}, count: 10}} makes ten"
        )
    try:
        return BatchModel.model_validate(values)
    except ValidationError as error:
        found = error.errors()[0]
        key = ".".join(map(str, found["loc"]))
        known = f": choose from {', '.join(BatchModel.model_fields)}" if found["type"] == "extra_forbidden" else ""
        message = found["msg"].removeprefix("Value error, ")
        text = "unknown key" if known else message[0].lower() + message[1:]
        raise InputError(f"{path}: {key}{' - ' if key else ''}{text}{known}") from None
