"""Rays on which the number of bases and the energy of a K edge are judged: inside the object, away from its edges.

Where a model of too few bases fails, it fails for whole regions. A ray is picked by how badly its neighbours are
explained, never by its own counts, so that the noise which is judged later has had no part in the choice.
"""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy.ndimage import gaussian_filter, uniform_filter

from phantomgen.dataset.reader import Dataset
from recon.data.measurements import Measurements, matching_bin, read_measurements
from recon.data.projection_edges import edge_mask
from recon.data.view_subsets import kinds_of, spread
from recon.ops.decompose import decompose
from recon.ops.deviance import deviance
from spectra.transmission import Transmission

VIEWS = 12  # at most, evenly spread over the training views
MOST_PIXELS = 250_000  # of all these views together, after binning
FEWEST_COUNTS = 20.0  # below, deviances do not follow chi-square
SHALLOW = 0.02  # largest log projection of a ray that passes by the object
SMOOTHING = 1.0  # pixels; of log projections, before edges are looked for
ITERATIONS = 12  # of a decomposition; bases that are nearly the same would take many more, and save nothing
NEIGHBOURHOOD = 5  # pixels along each side of the square whose middle is judged


@dataclass(frozen=True, eq=False)
class Rays:
    """Rays and where they came from.

    Parameters
    ----------
    counts, gains : as in `recon.data.measurements`; a gain of 0 where a channel measured nothing
    known : lengths of the profile's parts, None where there is no profile
    places : view, row and column
    """

    counts: Float[np.ndarray, "ray channel"]
    gains: Float[np.ndarray, "ray channel"]
    known: Float[np.ndarray, "ray part"] | None
    places: Int[np.ndarray, "3 ray"]

    def __len__(self) -> int:
        return len(self.counts)

    def __getitem__(self, chosen: Int[np.ndarray, " few"] | Bool[np.ndarray, " ray"] | slice) -> "Rays":
        """Some of the rays."""
        known = None if self.known is None else self.known[chosen]
        return Rays(self.counts[chosen], self.gains[chosen], known, self.places[:, chosen])

    def joined(self, other: "Rays") -> "Rays":
        """Rays of both, each once."""
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
        """Channels that measured, on the rays with most of them."""
        return int((self.gains > 0).sum(axis=1).max(initial=0))

    def decomposed(
        self, transmission: Transmission, dispersion: float
    ) -> tuple[Float[np.ndarray, "ray basis"], Float[np.ndarray, "ray basis basis"]]:
        """Line integrals of every ray that explain its counts best, and their Fisher information."""
        return decompose(self.counts, self.gains, transmission, dispersion, ITERATIONS, known=self.known)

    def explained(
        self, transmission: Transmission, dispersion: float
    ) -> tuple[Float[np.ndarray, " ray"], Float[np.ndarray, "ray basis"]]:
        """Deviance of every ray from its own best line integrals, and those."""
        lengths, _ = self.decomposed(transmission, dispersion)
        whole = lengths if self.known is None else np.hstack([lengths, self.known])
        expected = transmission.expected(whole) * self.gains
        each = deviance(torch.from_numpy(self.counts), torch.from_numpy(expected), dispersion).numpy()
        return np.where(self.gains > 0, each, 0.0).sum(axis=1), lengths

    def worst(self, transmission: Transmission, dispersion: float, count: int) -> "Rays":
        """The `count` rays in whose neighbourhood this model explains the counts worst, least well first."""
        return self[self.highest(self.explained(transmission, dispersion)[0], count)]

    def highest(self, excess: Float[np.ndarray, " ray"], count: int) -> Int[np.ndarray, " few"]:
        """The `count` rays whose neighbours have the highest mean, highest first; their own value has no say."""
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
    """Rays of some training views that pass through the object, more than two pixels from its edges.

    Edges are looked for in the smoothed log projections of each channel; nothing else is known about the object.

    Parameters
    ----------
    dataset : an open dataset
    binned : whether pixels are joined to the size of a voxel
    """
    train = dataset.splits["train"]
    binning = matching_bin(dataset.geometry, min(dataset.grid.spacing)) if binned else 1
    rows, columns = (n // binning for n in dataset.counts.shape[2:])
    count = int(np.clip(MOST_PIXELS // (rows * columns), 1, min(VIEWS, len(train))))
    some = train[spread(kinds_of(dataset.exposure[train]), count)]
    measured = read_measurements(dataset, some).summed(binning)
    inside = np.stack([_inside(measured, view) for view in range(len(some))])
    places = np.stack(np.nonzero(inside))
    view, row, column = places
    gains = measured.gains[:, row, column].T * measured.exposure[view]
    known = None if measured.profile is None else np.ascontiguousarray(measured.profile[:, row, column].T)
    counts = measured.counts[view, :, row, column]
    return Rays(counts.astype(np.float64), gains.astype(np.float64), known, places)


def _inside(measured: Measurements, view: int) -> Bool[np.ndarray, "row column"]:
    """Rays of one view through the object, away from its edges, with counts enough in all channels that measured."""
    open_beam = measured.open_beam * measured.gains * measured.exposure[view][:, None, None]
    taken = open_beam.max(axis=(1, 2)) > 0
    counts, open_beam = measured.counts[view][taken], open_beam[taken]
    smooth = np.stack([gaussian_filter(image.astype(np.float64), SMOOTHING) for image in counts])
    logs = np.log(np.maximum(open_beam, 0.5) / np.maximum(smooth, 0.5))
    away = edge_mask(logs)
    measuring = (measured.gains[taken] > 0).all(axis=0)
    return away & measuring & (smooth.min(axis=0) >= FEWEST_COUNTS) & (logs.max(axis=0) > SHALLOW)
