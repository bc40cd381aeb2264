"""The one object that turns line integrals into expected counts.

Simulator, decomposition and fit use the same `Transmission`, on grids of their own:
counts_c = sum_k w_ck exp(-sum_m B_m(E_k) L_m) with w_ck = photons x response. The columns B_m are any functions of
energy: dimensionless basis functions, then L is a line integral of coefficients; or attenuation curves in 1/mm, then L
is a path length in mm per material.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int64

from spectra.cramer_rao import least_covariance
from spectra.energy.node_reduction import ReducedNodes, choose_nodes, compress_channel
from spectra.errors import InputError
from spectra.ops.transmit import expected_and_jacobian, expected_counts, log_counts_and_slopes
from spectra.threads import run_parallel, without_other_pools


@dataclass(frozen=True, eq=False)
class Transmission:
    """Map from line integrals to expected counts: energy nodes grouped by channel.

    Parameters
    ----------
    columns : the functions of energy at the nodes, (M, K); their product with a line integral has no unit
    weights : photons x response of each node [counts]
    starts : channel c owns the nodes ``starts[c]`` to ``starts[c + 1]``
    channel_names : one name per channel; ``bin0``, ``bin1``, ... when left out

    Notes
    -----
    A channel without nodes is legal and blind: 0 expected counts, log projection 0, and no Fisher information.
    """

    columns: Float[np.ndarray, "basis node"]
    weights: Float[np.ndarray, " node"]
    starts: Int64[np.ndarray, " channel_plus_1"]
    channel_names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name, dtype in (("columns", np.float64), ("weights", np.float64), ("starts", np.int64)):
            object.__setattr__(self, name, np.ascontiguousarray(getattr(self, name), dtype=dtype))
        _check(self.columns, self.weights, self.starts)
        names = tuple(self.channel_names) or tuple(f"bin{c}" for c in range(len(self)))
        if len(names) != len(self):
            raise InputError(f"{len(names)} channel names were given for {len(self)} channels")
        object.__setattr__(self, "channel_names", names)

    @classmethod
    def from_spectrum(
        cls,
        weights: Float[np.ndarray, "channel energy"],
        columns: Float[np.ndarray, "basis energy"],
        channel_names: tuple[str, ...] = (),
    ) -> "Transmission":
        """Create a transmission from photons x response and columns on one energy grid; zero weights are dropped.

        Parameters
        ----------
        weights : photons x response, (C, E)
        columns : functions of energy, (M, E)
        channel_names : one name per channel; ``bin0``, ``bin1``, ... when left out

        Returns
        -------
        transmission with the nodes of all channels

        Raises
        ------
        InputError
            When weights and columns have different grids, or a weight is negative.
        """
        weights, columns = np.atleast_2d(weights), np.atleast_2d(columns)
        if weights.shape[1] != columns.shape[1]:
            raise InputError(f"weights are given at {weights.shape[1]} energies but columns at {columns.shape[1]}")
        kept = [np.flatnonzero(row) for row in weights]
        starts = np.concatenate([[0], np.cumsum([len(nodes) for nodes in kept])])
        flat = np.concatenate([row[nodes] for row, nodes in zip(weights, kept, strict=True)])
        return cls(columns[:, np.concatenate(kept)], flat, starts, channel_names)

    def __len__(self) -> int:
        return len(self.starts) - 1

    def __repr__(self) -> str:
        nodes = " + ".join(str(n) for n in np.diff(self.starts))
        return f"Transmission({len(self)} channels, {len(self.columns)} columns, {nodes} nodes)"

    @property
    def open_beam(self) -> Float[np.ndarray, " channel"]:
        """Expected counts with nothing in the beam."""
        return np.array([self.weights[a:b].sum() for a, b in pairwise(self.starts)])

    def expected(self, lengths: Float[np.ndarray, "... basis"]) -> Float[np.ndarray, "... channel"]:
        """Compute expected counts of line integrals; 0 when everything is absorbed.

        Parameters
        ----------
        lengths : line integrals, (..., M): [mm] for materials, [mm x 1/mm] for basis functions

        Returns
        -------
        expected counts, (..., C)
        """
        rays, shape = self._rays(lengths)
        return expected_counts(rays, self.columns, self.weights, self.starts).reshape(*shape, len(self))

    def expected_and_jacobian(
        self, lengths: Float[np.ndarray, "... basis"]
    ) -> tuple[Float[np.ndarray, "... channel"], Float[np.ndarray, "... channel basis"]]:
        """Compute expected counts and their derivatives dY_c/dL_m in one pass.

        Parameters
        ----------
        lengths : line integrals, (..., M)

        Returns
        -------
        counts, (..., C), and Jacobian, (..., C, M)
        """
        rays, shape = self._rays(lengths)
        counts, jacobian = expected_and_jacobian(rays, self.columns, self.weights, self.starts)
        return counts.reshape(*shape, len(self)), jacobian.reshape(*shape, len(self), len(self.columns))

    def jacobian(self, lengths: Float[np.ndarray, "... basis"]) -> Float[np.ndarray, "... channel basis"]:
        """Compute the derivatives dY_c/dL_m of the expected counts; never positive for positive columns.

        Parameters
        ----------
        lengths : line integrals, (..., M)

        Returns
        -------
        Jacobian, (..., C, M)
        """
        return self.expected_and_jacobian(lengths)[1]

    def log_projection(self, lengths: Float[np.ndarray, "... basis"]) -> Float[np.ndarray, "... channel"]:
        """Compute the log projection -log(Y_c / Y_c(0)).

        Parameters
        ----------
        lengths : line integrals, (..., M)

        Returns
        -------
        log projections, (..., C): exactly 0 without material and finite for any finite path, also where Y underflows
        """
        return self.log_projection_and_slopes(lengths)[0]

    def log_projection_and_slopes(
        self, lengths: Float[np.ndarray, "... basis"]
    ) -> tuple[Float[np.ndarray, "... channel"], Float[np.ndarray, "... channel basis"]]:
        """Compute the log projections y_c and their derivatives dy_c/dL_m.

        Parameters
        ----------
        lengths : line integrals, (..., M)

        Returns
        -------
        log projections, (..., C), and derivatives, (..., C, M), each the mean of a column over the photons that are
        left
        """
        rays, shape = self._rays(lengths)
        air = np.zeros((1, len(self.columns)))
        log_air = log_counts_and_slopes(air, self.columns, self.weights, self.starts)[0]
        log_counts, slopes = log_counts_and_slopes(rays, self.columns, self.weights, self.starts)
        projection = np.where(np.isneginf(log_air), 0.0, np.where(np.isneginf(log_air), 0.0, log_air) - log_counts)
        return projection.reshape(*shape, len(self)), slopes.reshape(*shape, len(self), len(self.columns))

    def fisher(
        self, lengths: Float[np.ndarray, "... basis"], dispersion: float = 0.0
    ) -> Float[np.ndarray, "... basis basis"]:
        """Compute the Fisher information of the line integrals, J^T diag(1 / (Y + (dispersion Y)^2)) J.

        Parameters
        ----------
        lengths : line integrals
        dispersion : relative model error added to the Poisson variance; 0 for pure Poisson

        Returns
        -------
        Fisher information, (..., M, M)

        Notes
        -----
        Written with the slopes of log Y, so that rays without photons give 0 instead of 0/0.
        """
        projection, slopes = self.log_projection_and_slopes(lengths)
        counts = self.open_beam * np.exp(-projection)
        information = counts / (1.0 + dispersion**2 * counts)
        return np.einsum("...c,...cm,...cn->...mn", information, slopes, slopes, optimize=True)

    def cramer_rao(
        self, lengths: Float[np.ndarray, "... basis"], dispersion: float = 0.0
    ) -> Float[np.ndarray, "... basis basis"]:
        """Compute the smallest covariance of unbiased estimates of the line integrals, the inverse of `fisher`.

        All entries are infinite where the channels cannot separate the columns: no photons are left, there are fewer
        channels than columns, or the condition number of the information, each column scaled to 1, exceeds 1e12.

        Parameters
        ----------
        lengths : line integrals
        dispersion : relative model error added to the Poisson variance; 0 for pure Poisson

        Returns
        -------
        covariance, (..., M, M)
        """
        return least_covariance(self.fisher(lengths, dispersion))

    @without_other_pools()
    def compress(
        self,
        box_low: Float[np.ndarray, " basis"],
        box_high: Float[np.ndarray, " basis"],
        tolerance: float,
        seed: int = 0,
        refine: bool = True,
        thorough: bool = False,
    ) -> tuple["Transmission", float]:
        """Reduce the nodes to fewer ones that give the same counts for every ray with line integrals in a box.

        Parameters
        ----------
        box_low, box_high : smallest and largest line integral per column that the scene can reach
        tolerance : largest error of log counts that is wanted
        seed : of the sampled line integrals
        refine : whether nodes are merged and moved; without, some of the nodes are kept: more of them, found sooner
        thorough : whether to look for the fewest nodes of all, for seconds per channel

        Returns
        -------
        the smaller transmission (the same one where nothing could be saved), and the worst error of its log counts on
        rays of the box that were not used to find it

        Raises
        ------
        InputError
            When the tolerance is not positive, or the box does not fit the columns.
        """
        box = self.checked_box(box_low, box_high)
        if not tolerance > 0:
            raise InputError(f"the tolerance of a compression must be positive, got {tolerance:g}")

        def channel(c: int) -> ReducedNodes:
            own = slice(self.starts[c], self.starts[c + 1])
            rng = np.random.default_rng([seed, c])
            return compress_channel(self.weights[own], self.columns[:, own], box, tolerance, rng, refine, thorough)

        return self._with_channels(run_parallel(channel, range(len(self))))

    def choose(self, lengths: Float[np.ndarray, "ray basis"], tolerance: float) -> tuple["Transmission", float]:
        """Select some of the nodes, with other weights, that give the same counts for rays like the given ones.

        For so many columns that no sample fills a box of them, where `compress` fails.

        Parameters
        ----------
        lengths : line integrals of rays in any order; rays without material are added
        tolerance : largest error of log counts that is wanted

        Returns
        -------
        the smaller transmission, with all nodes in channels where no choice errs by less, and the worst error of its
        log counts on every second ray, which were not used to find it
        """
        rays, _ = self._rays(lengths)

        def channel(c: int) -> ReducedNodes:
            own = slice(self.starts[c], self.starts[c + 1])
            return choose_nodes(self.weights[own], self.columns[:, own], rays, tolerance)

        return self._with_channels(run_parallel(channel, range(len(self))))

    def _with_channels(self, channels: Iterable[ReducedNodes]) -> tuple["Transmission", float]:
        """Replace weights and columns of all channels; also return the worst of their errors."""
        weights, columns, errors = zip(*channels, strict=True)
        starts = np.concatenate([[0], np.cumsum([len(w) for w in weights])])
        small = Transmission(np.concatenate(columns, axis=1), np.concatenate(weights), starts, self.channel_names)
        return small, max(errors)

    def checked_box(
        self, low: Float[np.ndarray, " basis"], high: Float[np.ndarray, " basis"]
    ) -> Float[np.ndarray, "2 basis"]:
        """Return the smallest and largest line integrals as one array.

        Parameters
        ----------
        low, high : smallest and largest line integral of each column

        Returns
        -------
        array of shape (2, M)

        Raises
        ------
        InputError
            When the limits do not ascend or do not fit the columns.
        """
        if np.shape(low) != np.shape(high) or np.shape(low) != (len(self.columns),):
            raise InputError(f"the box of line integrals must ascend and have {len(self.columns)} entries each")
        box = np.array([low, high], dtype=np.float64)
        if not np.isfinite(box).all() or (box[0] > box[1]).any():
            raise InputError(f"the box of line integrals must ascend and have {len(self.columns)} entries each")
        return box

    def _rays(self, lengths: Float[np.ndarray, "... basis"]) -> tuple[Float[np.ndarray, "ray basis"], tuple[int, ...]]:
        """Line integrals as rows, and the shape in front of the last axis."""
        lengths = np.asarray(lengths, dtype=np.float64)
        if lengths.ndim == 0 or lengths.shape[-1] != len(self.columns):
            raise InputError(f"line integrals of shape {lengths.shape} do not end in {len(self.columns)} columns")
        return lengths.reshape(-1, len(self.columns)), lengths.shape[:-1]


def _check(columns: np.ndarray, weights: np.ndarray, starts: np.ndarray) -> None:
    """Refuse arrays that do not belong together."""
    if columns.ndim != 2 or columns.shape[0] == 0 or weights.shape != columns.shape[1:]:
        raise InputError(f"columns of shape {columns.shape} do not fit weights of shape {weights.shape}")
    if (
        starts.ndim != 1
        or len(starts) < 2
        or (starts[0], starts[-1]) != (0, len(weights))
        or (np.diff(starts) < 0).any()
    ):
        raise InputError(f"starts must rise from 0 to the number of nodes, {len(weights)}, got {starts.tolist()}")
    if not (np.isfinite(columns).all() and np.isfinite(weights).all()):
        raise InputError("columns and weights of a transmission must be finite")
    if (weights < 0).any():
        raise InputError(f"the weights of a transmission must not be negative, got {weights.min():g}")
