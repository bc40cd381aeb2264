"""The same scan with other noise: counts that a fitted model expects, with random numbers of their own.

References
----------
.. [1] Efron & Tibshirani 1993, An Introduction to the Bootstrap, chapter 6.5: the parametric bootstrap
.. [2] Yavuz & Fessler 1998, Med. Image Anal. 2, 369: Poisson numbers minus a constant for readout noise
"""

from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Protocol, SupportsInt, runtime_checkable

import numpy as np
from jaxtyping import Float, Shaped
from torch import Tensor

from phantomgen.dataset.checks.door import find_array
from phantomgen.dataset.file import FLAT
from phantomgen.dataset.reader import Dataset
from phantomgen.dataset.spectral_model import Spectra
from phantomgen.geometry.poses import Geometry
from recon.data.measurements import Measurements, read_measurements
from recon.data.readout_noise import without_floor

_FLATS = (1 << 63) - 1  # in place of the number of a view, for the random numbers of flats

Image = Float[np.ndarray, "channel row column"]


@runtime_checkable
class ProjectedModel(Protocol):
    """Interface of what counts are computed from: Gaussians, volumes, or what is left of them without a part."""

    @property
    def basis_names(self) -> tuple[str, ...]:
        """Names of the bases."""
        ...

    def line_integrals(self, geometry: Geometry) -> Float[Tensor, "view basis row column"]:
        """Compute the line integrals of each basis.

        Parameters
        ----------
        geometry : poses of the views

        Returns
        -------
        one image per view and basis [no unit]
        """
        ...


@dataclass(frozen=True, eq=False, kw_only=True)
class Replicate(Dataset):
    """A dataset whose counts are drawn anew around those that a model expects; all else is that of the file.

    Counts are independent Poisson numbers around the expected ones, and readout noise has the variance of the darks.
    Flats have noise of their own around the measured ones. The same seed and number give the same counts of a view,
    in whatever order views are loaded.

    Parameters
    ----------
    model : volumes or Gaussians that the counts are computed from, in the first basis functions of the dataset
    measured : the dataset with its own counts
    seed, number : of the random numbers
    """

    model: ProjectedModel = field(repr=False)
    measured: Dataset = field(repr=False)
    seed: int
    number: int

    @classmethod
    def of(
        cls, dataset: Dataset, model: ProjectedModel, seed: int, number: int, measured: Dataset | None = None
    ) -> "Replicate":
        """Create a replicate of a dataset.

        Parameters
        ----------
        dataset : open dataset, in the basis functions of the model
        model : the reconstruction
        seed, number : of the random numbers
        measured : the same dataset in the basis functions of the model, where `dataset` has others

        Returns
        -------
        the replicate, which reads the same open file
        """
        replicate = cls(
            dataset.path, dataset.file, dataset.air, model=model, measured=measured or dataset, seed=seed, number=number
        )
        own = {name: value for name, value in vars(dataset).items() if name != "flat"}
        vars(replicate).update(own | vars(replicate))
        return replicate

    def load(self, views: Iterable[SupportsInt] | None = None) -> Shaped[np.ndarray, "v c row column"]:
        """Draw the counts of some views.

        Parameters
        ----------
        views : numbers of the views; all where left out

        Returns
        -------
        counts, (view, channel, row, column), float32
        """
        chosen = range(self.counts.shape[0]) if views is None else [int(view) for view in views]
        loaded = np.empty((len(chosen), *self.counts.shape[1:]), np.float32)
        for place, view in enumerate(chosen):
            loaded[place] = self._drawn(view)
        return loaded

    @cached_property
    def flat(self) -> Image:
        """Mean open-beam counts at exposure 1, with noise of their own; without it where air takes their place."""
        flat, frames = self.measured.flat, find_array(self.file, FLAT)
        if self.air is not None or frames is None:
            return flat
        per_photon = self.spectra.quantum[:, None, None] / len(frames)
        return self._random(_FLATS).poisson(np.maximum(flat / per_photon, 0.0)) * per_photon

    def _random(self, view: int) -> np.random.Generator:
        """Random numbers of a view."""
        return np.random.Generator(np.random.Philox(np.random.SeedSequence((self.seed, self.number, view))))

    def _drawn(self, view: int) -> Image:
        """Draw the reading of a view."""
        one = read_measurements(self.measured, np.array([view]), len(self.model.basis_names), separable=False)
        expected, unit = expected_quanta(one, self.model), self.spectra.quantum[:, None, None]
        exposed = one.gains * one.exposure[0][:, None, None]
        floor = without_floor(one.transmission)[1][:, None, None] * exposed
        expected = expected + one.scattered(0)
        events = (self._random(view).poisson(expected) - floor) * unit
        if self.spectra.dead_time is not None:
            events = _with_losses(events, (expected - floor) * unit, self.spectra)
        reading = events + self.dark
        return reading if self.signed else np.maximum(reading, 0.0)


def _with_losses(events: Image, mean: Image, spectra: Spectra) -> Image:
    """Counts that are left of events after dead time, with the mean and the variance that it leaves."""
    dead_time, total = spectra.dead_time, mean.sum(axis=0)
    assert dead_time is not None
    return spectra.recorded(mean) + np.sqrt(dead_time.live(total) * dead_time.fano(total)) * (events - mean)


def expected_quanta(one: Measurements, model: ProjectedModel) -> Image:
    """Compute the expected counts of one view, in units in which their variance is their mean.

    Parameters
    ----------
    one : measurements of the view
    model : volumes or Gaussians

    Returns
    -------
    expected counts, readout noise included as in `recon.data.readout_noise`; 0 where a pixel does not measure
    """
    lengths = one.with_profile(np.moveaxis(model.line_integrals(one.geometry).numpy(), 1, -1))
    expected = np.moveaxis(one.transmission.expected(lengths)[0], -1, 0)
    return expected * one.gains * one.exposure[0][:, None, None]
