"""What a scan is expected to have measured, as a function of tensors: with exposure, gains, dead time and darks."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from phantomgen.dataset.reader import Dataset
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.torch.geometry import TensorGeometry
from phantomgen.torch.operators import project, transmit
from phantomgen.torch.spectra import TensorSpectra
from spectra.detector.dead_time import DeadTime
from spectra.errors import DatasetError


@dataclass(frozen=True, eq=False)
class ForwardModel:
    """Expected counts of a scan; call it with basis volumes. Every tensor may be replaced by one with a gradient.

    Parameters
    ----------
    grid : voxels of the volumes
    geometry : poses of all views
    spectra : spectral model
    exposure : tube output of each view and channel relative to the flat frames; 0 where it was not measured
    gains : open-beam counts of each pixel over those that `spectra` expects; 0 where a pixel does not measure
    dark : mean counts without beam
    profile : line integrals in the absorbers of the beam profile, in each pixel; None where there are none
    dead_time : of the pixels; None where every event is recorded
    """

    grid: Grid
    geometry: TensorGeometry
    spectra: TensorSpectra
    exposure: Float[Tensor, "view channel"]
    gains: Float[Tensor, "channel row column"]
    dark: Float[Tensor, "channel row column"]
    profile: Float[Tensor, "part row column"] | None = None
    dead_time: DeadTime | None = None

    @classmethod
    def of(cls, dataset: Dataset, device: torch.device | str = "cpu") -> "ForwardModel":
        """Create the model of a dataset: all that a reconstructor may know, and no truth.

        Parameters
        ----------
        dataset : open dataset
        device : of all tensors

        Returns
        -------
        the model

        Raises
        ------
        DatasetError
            When the dataset has no flats, or pulses that pile up.
        """
        stored = dataset.spectra
        if stored.pulses is not None:
            raise DatasetError(
                f"{dataset.path} has pulses that pile up (detector/pulse_response), which this model does not know: "
                "make the scan without detector.pile_up"
            )
        spectra, flat, dead_time = TensorSpectra.of(stored, device), dataset.flat, stored.dead_time
        flat = stored.events(flat)
        profile = None if stored.profile is None else torch.tensor(stored.profile.lengths, device=device)
        model = cls(
            grid=dataset.grid,
            geometry=TensorGeometry.of(dataset.geometry, device),
            spectra=spectra,
            exposure=torch.tensor(dataset.exposure.copy(), device=device),
            gains=torch.ones(dataset.counts.shape[1:], dtype=torch.float64, device=device),
            dark=torch.tensor(dataset.dark, device=device),
            profile=profile,
            dead_time=dead_time,
        )
        air = model.open_beam().cpu().numpy()
        measures = ~dataset.mask & (air > 0)
        gains = np.where(measures, np.maximum(flat, 0) / np.where(measures, air, 1), 0)
        return replace(model, gains=torch.tensor(gains, device=device))

    def __call__(
        self, volume: Float[Tensor, "*batch basis z y x"], views: Any = slice(None)
    ) -> Float[Tensor, "*batch view channel row column"]:
        """Compute the expected counts of basis volumes.

        Parameters
        ----------
        volume : coefficients of the basis functions [1/mm]
        views : a slice, or a list or tensor of numbers

        Returns
        -------
        counts of these views, comparable with ``dataset.load(views)``
        """
        return self.from_line_integrals(project(volume, self.grid, self.geometry[views]), views)

    def from_line_integrals(
        self, line_integrals: Float[Tensor, "*batch basis view row column"], views: Any = slice(None)
    ) -> Float[Tensor, "*batch view channel row column"]:
        """Compute the expected counts of line integrals.

        Parameters
        ----------
        line_integrals : of the basis functions, as `project` gives them
        views : the views that they belong to

        Returns
        -------
        counts
        """
        if self.profile is not None:
            shape = (*line_integrals.shape[:-4], len(self.profile), *line_integrals.shape[-3:])
            fixed = self.profile[:, None].to(line_integrals).expand(shape)
            line_integrals = torch.cat([line_integrals, fixed], dim=-4)
        events = transmit(line_integrals, self.spectra)
        events = events * (self.exposure[views, :, None, None] * self.gains).to(events)
        return self._recorded(events) + self.dark.to(events)

    def measures(self, views: Any = slice(None)) -> Bool[Tensor, "view channel row column"]:
        """Return which pixels of which views measure; leave the others out of a loss.

        Parameters
        ----------
        views : a slice, or a list or tensor of numbers

        Returns
        -------
        True where a pixel measures
        """
        return (self.exposure[views, :, None, None] > 0) & (self.gains > 0)

    def open_beam(self) -> Float[Tensor, "channel row column"]:
        """Compute the counts that the spectral model expects without an object, at exposure and gain 1.

        Returns
        -------
        counts without losses from dead time and without darks
        """
        parts = len(self.spectra.columns) - (0 if self.profile is None else len(self.profile))
        air = self.dark.new_zeros(parts, *self.dark.shape[1:])
        lengths = air if self.profile is None else torch.cat([air, self.profile])
        return transmit(lengths[:, None], self.spectra)[0]

    def _recorded(self, events: Tensor) -> Tensor:
        """Mean recorded counts of mean events; the formulas are those of `DeadTime.live`."""
        if self.dead_time is None:
            return events
        load = self.dead_time.per_count * events.sum(dim=-3, keepdim=True)
        return events / (1 + load) if self.dead_time.model == "nonparalyzable" else events * torch.exp(-load)
