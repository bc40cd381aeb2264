"""Scans as physics and as data sets of DeepInverse (https://deepinv.github.io), which this module imports.

Batches have the batch axis first: volumes (batch, basis, z, y, x), counts (batch, view, channel, row, column).
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from jaxtyping import Float
from torch import Tensor

from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.torch.forward_model import ForwardModel
from phantomgen.torch.geometry import TensorGeometry
from phantomgen.torch.operators import back_project, project
from phantomgen.torch.scans import ScanSet
from spectra.errors import InputError, NotInstalledError

try:
    from deepinv.datasets import ImageDataset  # type: ignore[import-not-found]
    from deepinv.physics import LinearPhysics, Physics  # type: ignore[import-not-found]
except ModuleNotFoundError as problem:
    raise NotInstalledError("adapters for DeepInverse need it: pip install 'spectral-ct[deepinv]'") from problem


class ProjectorPhysics(LinearPhysics):
    """Line integrals as linear physics, whose adjoint is the exact transpose.

    Parameters
    ----------
    grid : voxels of the volumes
    geometry : poses
    **options : of `deepinv.physics.LinearPhysics`, such as ``noise_model``
    """

    def __init__(self, grid: Grid, geometry: Geometry | TensorGeometry, **options: Any) -> None:
        super().__init__(**options)
        self.grid, self.geometry = grid, TensorGeometry.of(geometry)

    def A(
        self, x: Float[Tensor, "batch component z y x"], **_: Any
    ) -> Float[Tensor, "batch component view row column"]:
        """Compute line integrals.

        Parameters
        ----------
        x : volumes
        **_ : parameters of other physics

        Returns
        -------
        line integrals
        """
        return project(x, self.grid, self.geometry)

    def A_adjoint(
        self, y: Float[Tensor, "batch component view row column"], **_: Any
    ) -> Float[Tensor, "batch component z y x"]:
        """Apply the transpose.

        Parameters
        ----------
        y : images
        **_ : parameters of other physics

        Returns
        -------
        volumes
        """
        return back_project(y, self.grid, self.geometry)


class ScanPhysics(Physics):
    """Expected counts of a scan as non-linear physics; `A_vjp` has its gradient.

    Parameters
    ----------
    model : of a dataset, ``ForwardModel.of(dataset)``
    views : numbers of the views; all where left out
    **options : of `deepinv.physics.Physics`, such as ``noise_model=deepinv.physics.PoissonNoise()``
    """

    def __init__(self, model: ForwardModel, views: Sequence[int] | None = None, **options: Any) -> None:
        super().__init__(**options)
        self.model, self.views = model, slice(None) if views is None else [int(view) for view in views]

    def A(self, x: Float[Tensor, "batch basis z y x"], **_: Any) -> Float[Tensor, "batch view channel row column"]:
        """Compute expected counts.

        Parameters
        ----------
        x : coefficients of the basis functions [1/mm]
        **_ : parameters of other physics

        Returns
        -------
        counts
        """
        return self.model(x, self.views)


class ScanImages(ImageDataset):
    """Scans as pairs for DeepInverse: ``x`` the true volumes, ``y`` what was measured.

    Parameters
    ----------
    paths : of the datasets
    split : ``train``, ``test``, ``val``, or ``all`` for all views
    measured : ``counts`` (view, channel, row, column), as `ScanPhysics` gives them, or ``line_integrals`` (channel,
        view, row, column), one volume per channel for `ProjectorPhysics.A_adjoint`; 0 where a pixel does not measure

    Raises
    ------
    InputError
        When something else is asked for.
    """

    def __init__(self, paths: Sequence[Path | str], split: str = "train", measured: str = "counts") -> None:
        super().__init__(use_dict_output=True)
        if measured not in ("counts", "line_integrals"):
            raise InputError(f"measured must be counts or line_integrals, got {measured!r}")
        self.scans, self.measured = ScanSet(paths, split), measured

    def __len__(self) -> int:
        return len(self.scans)

    def __getitem__(self, idx: int) -> dict[str, Tensor]:
        """Pair of a scan."""
        item = self.scans[idx]
        if "truth" not in item:
            raise InputError(f"{self.scans.paths[idx]} holds no truth: DeepInverse needs it as x")
        y = item[self.measured]
        return {"x": item["truth"], "y": y if self.measured == "counts" else y.movedim(1, 0).nan_to_num(nan=0.0)}
