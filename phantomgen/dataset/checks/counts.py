"""Counts that no detector can have."""

import numpy as np
from jaxtyping import Shaped

from spectra.errors import DatasetError


def check_counts(counts: Shaped[np.ndarray, "..."], where: str, signed: bool = False) -> None:
    """Refuse values that cannot be counts, or cannot be signals, which may be negative.

    Parameters
    ----------
    counts : values of any shape
    where : their place, for the message
    signed : whether negative values are allowed

    Raises
    ------
    DatasetError
        When a value is negative, infinite or not a number (NaN).
    """
    smallest = counts.min(initial=0)
    if np.isnan(smallest) or np.isinf(counts.max(initial=0)):
        raise DatasetError(f"{where} holds a value that is not a number; repair or leave out that view")
    if smallest < 0 and not signed:
        raise DatasetError(f"{where} holds negative counts, down to {smallest:g}; store raw counts, with darks apart")
