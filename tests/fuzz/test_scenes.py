"""Scenes whose values or bytes are spoiled are simulated, or refused in one sentence."""

import h5py
import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from support.door import limited, run, tries
from support.mutations import spoiled_bytes, spoiled_documents
from support.tiny_scenes import SCENE, TINY

from phantomgen.cli.main import main as phantomgen
from phantomgen.scene.file.scene_file import SceneFile, preset_names
from phantomgen.scene.scan import load_scene
from spectra.errors import Error

pytestmark = pytest.mark.filterwarnings("default")
PRESETS = {name: SceneFile.preset(name).text for name in preset_names()}
DOCUMENTS = tuple(yaml.safe_load(text) for text in PRESETS.values())


def load(read):
    """Load a scene; a refusal is one short line."""
    with limited():
        refusal = None
        try:
            load_scene(read())
        except Error as error:
            refusal = str(error)
    assert refusal is None or "\n" not in refusal


@tries(60)
@given(document=spoiled_documents(DOCUMENTS))
@pytest.mark.slow
def test_presets_with_spoiled_values(document):
    text = yaml.safe_dump(document, allow_unicode=True)
    load(lambda: SceneFile("scene.yaml", text))


@tries(40)
@given(content=spoiled_bytes(tuple(text.encode() for text in PRESETS.values())))
def test_presets_with_spoiled_bytes(place, content):
    (place / "scene.yaml").write_bytes(content)
    load(lambda: SceneFile.read(place / "scene.yaml"))


@tries(6)
@given(document=spoiled_documents((SCENE,)), seed=st.integers(-1, 3))
def test_spoiled_scenes_are_simulated_without_nan_or_refused(place, document, seed):
    (place / "tiny.yaml").write_text(yaml.safe_dump(document, allow_unicode=True))
    result = run(phantomgen, "make", "tiny.yaml", "-q", "-o", "tiny.h5", "--overwrite", *TINY, "--set", f"seed={seed}")
    if result.exit_code == 0:
        with h5py.File(place / "tiny.h5") as file:
            for name in ("entry/instrument/detector/data", "entry/instrument/flat/data", "truth/basis/data"):
                assert np.isfinite(file[name][:]).all(), name
