"""Material maps of a run: which material is where, and what its numbers say.

`segment` is the whole way from a run folder to a `Segmentation`; the truth is read only to score it.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from recon.segmentation.pipeline import segment
    from recon.segmentation.result import Cluster, Options, Segmentation

__all__ = ["Cluster", "Options", "Segmentation", "segment"]


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used."""
    if name not in __all__:
        raise AttributeError(f"module 'recon.segmentation' has no attribute {name!r}")
    return getattr(import_module(f"recon.segmentation.{'pipeline' if name == 'segment' else 'result'}"), name)
