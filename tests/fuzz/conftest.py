"""Folder that commands run in, and warnings: those of NumPy are not what is tested here."""

import pytest


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """An empty folder that commands run in."""
    folder = tmp_path_factory.mktemp("fuzz")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        yield folder
