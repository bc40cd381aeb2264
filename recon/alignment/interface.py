"""Alignment of a scan in one line of Python."""

from pathlib import Path

from phantomgen.dataset.reader import Dataset, open_dataset
from phantomgen.dataset.writing.corrected_copy import check_copy
from recon.alignment.align import Alignment
from recon.alignment.align import align as estimate
from recon.alignment.panel_errors import NAMES


def align(
    scan: Dataset | Path | str,
    out: Path | str | None = None,
    *,
    free: tuple[str, ...] = NAMES,
    block: int | None = None,
    overwrite: bool = False,
) -> Alignment:
    """Estimate how far the panel of a scan lies from where it is stated, and write the scan with corrected poses.

    Parameters
    ----------
    scan : open dataset, or its file
    out : dataset to write; none is written where left out
    free : what is estimated, of ``columns`` and ``tilt``
    block : pixels along each side of the smallest blocks; chosen where left out
    overwrite : replace a file that exists

    Returns
    -------
    corrections with their standard uncertainties, and the corrected poses

    Raises
    ------
    InputError
        When the data do not determine the panel, or `out` cannot be written.

    Examples
    --------
    >>> import recon
    >>> found = recon.align("scan.h5", "aligned.h5")  # doctest: +SKIP
    >>> found.change  # columns [pixel], turn [degree]  # doctest: +SKIP
    """
    if not isinstance(scan, Dataset):
        with open_dataset(scan) as opened:
            return align(opened, out, free=free, block=block, overwrite=overwrite)
    if out is not None:
        check_copy(scan.path, Path(out), overwrite)
    found = estimate(scan, free, block=block)
    if out is not None:
        found.write(scan, out, overwrite=overwrite)
    return found
