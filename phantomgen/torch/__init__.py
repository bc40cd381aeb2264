"""Scans, projectors and spectra for PyTorch: `import phantomgen.torch`, which imports torch.

`project` and `back_project` are the voxel projector and its transpose, `transmit` turns line integrals into expected
counts; gradients reach volumes, poses and sensitivities. `ForwardModel` has them all for one dataset. `ScanSet`,
`ScanViews` and `ViewSet` are data sets for training. `phantomgen.torch.deepinv` has adapters for DeepInverse.
"""

from phantomgen.dataset.adapters.to_torch import ViewSet
from phantomgen.torch.forward_model import ForwardModel
from phantomgen.torch.geometry import TensorGeometry
from phantomgen.torch.operators import back_project, expected_counts, project, transmit
from phantomgen.torch.scans import ScanSet, ScanViews
from phantomgen.torch.spectra import TensorSpectra

__all__ = [
    "ForwardModel",
    "ScanSet",
    "ScanViews",
    "TensorGeometry",
    "TensorSpectra",
    "ViewSet",
    "back_project",
    "expected_counts",
    "project",
    "transmit",
]
