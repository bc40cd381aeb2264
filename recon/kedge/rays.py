"""Rays on which the number of bases and the energy of a K edge are judged: inside the object, away from its edges.

A model with too few bases fails for whole regions. A ray is chosen by how badly its neighbours are explained, never by
its own counts, so that the noise which is judged later takes no part in the choice.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import gaussian_filter, uniform_filter

from phantomgen.dataset.reader import Dataset
from recon.data.measurements import Measurements, matching_bin, read_measurements
from recon.data.partial_volume import LEAST_COUNTS
from recon.data.projection_edges import edge_mask
from recon.data.view_subsets import evenly_spread_views, view_groups

VIEWS = 12  # views, evenly spread over the training views; the largest number that is used; chosen by hand
MOST_PIXELS = 250_000  # pixels of all these views together, after binning; bounds time and memory
FEWEST_COUNTS = 20.0  # counts; with fewer, deviances do not follow the chi-square distribution; a rule of thumb
SHALLOW = 0.02  # log projection; rays with less pass beside the object; chosen by hand, not measured
SMOOTHING = 1.0  # pixels; standard deviation of the Gaussian that smooths counts before edges are found; by hand
NEIGHBOURHOOD = 5  # pixels along each side of the square around a ray whose other rays choose it; chosen by hand


@dataclass(frozen=True, eq=False)
class Rays:
    """Rays and their places.

    Parameters
    ----------
    counts, gains : as in `recon.data.measurements`, with exposures in the gains; a gain of 0 where a channel did not
        measure
    known : line integrals of the parts of the profile [no unit]; None where there is no profile
    places : view, row and column of each ray
    """

    counts: Float[np.ndarray, "ray channel"]
    gains: Float[np.ndarray, "ray channel"]
    known: Float[np.ndarray, "ray part"] | None
    places: Int[np.ndarray, "3 ray"]

    def __len__(self) -> int:
        return len(self.counts)

    def __getitem__(self, chosen: Int[np.ndarray, " few"] | Bool[np.ndarray, " ray"] | slice) -> "Rays":
        """Take some of the rays."""
        known = None if self.known is None else self.known[chosen]
        return Rays(self.counts[chosen], self.gains[chosen], known, self.places[:, chosen])

    def joined(self, other: "Rays") -> "Rays":
        """Unite two sets of rays.

        Parameters
        ----------
        other : further rays

        Returns
        -------
        the rays of both, each once
        """
        known = None if self.known is None or other.known is None else np.concatenate([self.known, other.known])
        both = Rays(
            np.concatenate([self.counts, other.counts]),
            np.concatenate([self.gains, other.gains]),
            known,
            np.concatenate([self.places, other.places], axis=1),
        )
        return both[np.unique(both.places, axis=1, return_index=True)[1]]

    @property
    def channels(self) -> int:
        """Number of channels that measured, on the rays with most of them."""
        return int((self.gains > 0).sum(axis=1).max(initial=0))

    def highest(self, excess: Float[np.ndarray, " ray"], count: int) -> Int[np.ndarray, " few"]:
        """Choose the rays whose neighbours have the highest mean; the value of the ray itself is not used.

        Parameters
        ----------
        excess : value of every ray, for instance a deviance
        count : largest number of rays to choose

        Returns
        -------
        indices of the rays, highest first; rays with too few neighbours are left out
        """
        shape = self.places.max(axis=1, initial=0) + 1
        total, seen = np.zeros(shape), np.zeros(shape)
        total[tuple(self.places)], seen[tuple(self.places)] = excess, 1.0
        pixels = NEIGHBOURHOOD**2
        sums, neighbours = (
            uniform_filter(image, NEIGHBOURHOOD, mode="constant", axes=(1, 2))[tuple(self.places)] * pixels - own
            for image, own in ((total, excess), (seen, 1.0))
        )
        mean = np.divide(sums, neighbours, out=np.full(len(self), -np.inf), where=neighbours > pixels / 2)
        order = np.argsort(-mean, kind="stable")[:count]
        return order[np.isfinite(mean[order])]


def rays_away_from_edges(dataset: Dataset, binned: bool = True) -> Rays:
    """Collect rays of some training views that pass through the object, more than two pixels from its edges.

    Edges are found in the smoothed log projections of each channel; nothing else is known about the object.

    Parameters
    ----------
    dataset : an open dataset
    binned : whether pixels are summed to the size of a voxel

    Returns
    -------
    the rays
    """
    train = dataset.splits["train"]
    binning = matching_bin(dataset.geometry, min(dataset.grid.spacing)) if binned else 1
    rows, columns = (n // binning for n in dataset.counts.shape[2:])
    count = int(np.clip(MOST_PIXELS // (rows * columns), 1, min(VIEWS, len(train))))
    some = train[evenly_spread_views(view_groups(dataset.exposure[train]), count)]
    measured = read_measurements(dataset, some).summed(binning)
    inside = np.stack([_inside(measured, view) for view in range(len(some))])
    places = np.stack(np.nonzero(inside))
    view, row, column = places
    gains = measured.gains[:, row, column].T * measured.exposure[view]
    known = None if measured.profile is None else np.ascontiguousarray(measured.profile[:, row, column].T)
    counts = measured.counts[view, :, row, column]
    return Rays(counts.astype(np.float64), gains.astype(np.float64), known, places)


def _inside(measured: Measurements, view: int) -> Bool[np.ndarray, "row column"]:
    """Rays of one view through the object, away from its edges, with enough counts in all channels that measured."""
    open_beam = measured.open_beam * measured.gains * measured.exposure[view][:, None, None]
    taken = open_beam.max(axis=(1, 2)) > 0
    counts, open_beam = measured.counts[view][taken], open_beam[taken]
    smooth = np.stack([gaussian_filter(image.astype(np.float64), SMOOTHING) for image in counts])
    logs = np.log(np.maximum(open_beam, LEAST_COUNTS) / np.maximum(smooth, LEAST_COUNTS))
    away = edge_mask(logs)
    measuring = (measured.gains[taken] > 0).all(axis=0)
    return away & measuring & (smooth.min(axis=0) >= FEWEST_COUNTS) & (logs.max(axis=0) > SHALLOW)
