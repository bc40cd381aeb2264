"""The scatter that a fit takes away: what ``--scatter`` says, as a file in the run folder, and as a dataset."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save_file

from phantomgen.dataset.reader import Dataset
from phantomgen.effects.scatter import ScatterKernel
from phantomgen.effects.smooth_signal import SmoothSignal
from recon.kedge.basis_names import Asked
from recon.scatter.models import Compton, FittedKernel, ScatterModel
from recon.voxel.method import OnIteration, no_callback
from spectra.errors import InputError

SCATTER = "scatter.safetensors"  # file in a run folder
_NAME = "scatter"
_ABOUT = "expected scattered signal per pixel at exposure 1 and gain 1: view, channel, place along rows, along columns"
_FORMS = (
    "--scatter takes compton, compton:FACTOR, compton:FACTOR,FACTOR,... (one per channel), compton:fit, "
    "compton:fit-channels, or kernel:RATIO,WIDTH with the width in mm, such as kernel:0.3,60, where fit or "
    "fit-channels may take the place of the ratio"
)


@dataclass(frozen=True, eq=False)
class ChosenScatter:
    """Scatter that is taken away from the counts of a dataset.

    Parameters
    ----------
    dataset : with the estimate, or as it was where nothing was asked for
    sentence : what was estimated; None where nothing was
    """

    dataset: Dataset
    sentence: str | None = None

    @classmethod
    def of(
        cls,
        dataset: Dataset,
        model: ScatterModel | None,
        asked: Asked = None,
        on_stage: Callable[[str], None] = lambda name: None,
        on_iteration: OnIteration = no_callback,
    ) -> "ChosenScatter":
        """Estimate the scatter of a dataset.

        Parameters
        ----------
        dataset : open dataset
        model : of `parse_scatter`; None for no estimate
        on_stage : called with the name of the stage when it begins
        asked, on_iteration : see `recon.scatter.estimate.estimate_scatter`

        Returns
        -------
        the choice
        """
        if model is None:
            return cls(dataset)
        from recon.scatter.estimate import estimate_scatter  # noqa: PLC0415 - only where it is asked for

        on_stage("scatter")
        found = estimate_scatter(dataset, model, asked, on_iteration)
        signal = found.signal
        open_beam = dataset.spectra.weights.sum(axis=1)
        parts = signal.values.mean(axis=(0, 2, 3)) / np.where(open_beam > 0, open_beam, np.inf)
        named = (f"{100 * part:.2g} % ({name})" for name, part in zip(dataset.spectra.channels, parts, strict=True))
        sentence = f"Estimated scatter, mean over views and panel, over the open beam: {', '.join(named)}"
        sentence += f"; fitted: {found.fitted}." if found.fitted else "."
        return cls(dataset.with_scatter(signal), sentence)

    @classmethod
    def of_run(cls, dataset: Dataset, folder: Path) -> "ChosenScatter":
        """Take the scatter that a run took away.

        Parameters
        ----------
        dataset : open dataset of the run
        folder : run folder

        Returns
        -------
        the scatter of its ``scatter.safetensors``, or none where it has no such file
        """
        path = folder / SCATTER
        return cls(dataset.with_scatter(read_scatter(path, dataset))) if path.is_file() else cls(dataset)

    def note(self, tell: Callable[[str], None]) -> None:
        """Tell a user how much scatter was estimated.

        Parameters
        ----------
        tell : takes a sentence
        """
        if self.sentence is not None:
            tell(self.sentence)

    def write(self, path: Path) -> None:
        """Write the estimate where there is one.

        Parameters
        ----------
        path : safetensors file
        """
        if self.dataset.scatter is not None:
            values = np.ascontiguousarray(self.dataset.scatter.values, np.float32)
            save_file({_NAME: values}, path, {"about": _ABOUT, "units": self.dataset.spectra.units})


def read_scatter(path: Path, dataset: Dataset) -> SmoothSignal:
    """Read the scatter of every view of a dataset.

    Parameters
    ----------
    path : file of `ChosenScatter.write`
    dataset : open dataset that it belongs to

    Returns
    -------
    the scattered signal

    Raises
    ------
    InputError
        When the file cannot be read, or has other views or channels, or no scatter.
    """
    try:
        with safe_open(path, "numpy") as file:
            values = file.get_tensor(_NAME).astype(np.float64)
    except (OSError, SafetensorError) as error:
        raise InputError(f"{path} cannot be read as an estimate of scatter: {error}") from None
    if values.ndim != 4 or values.shape[:2] != dataset.counts.shape[:2]:
        views, channels = dataset.counts.shape[:2]
        raise InputError(
            f"{path} holds scatter of shape {values.shape}, which must begin with the {views} views and {channels} "
            f"channels of {dataset.path}, and have two axes more"
        )
    return SmoothSignal(values)


def parse_scatter(text: str | None) -> ScatterModel | None:
    """Read the value of ``--scatter``.

    Parameters
    ----------
    text : ``compton``, ``compton:FACTOR`` (one, or one per channel with commas), ``compton:fit``,
        ``compton:fit-channels``, ``kernel:RATIO,WIDTH``, ``kernel:fit,WIDTH``, ``kernel:fit-channels,WIDTH``, or None

    Returns
    -------
    the model; None for None

    Raises
    ------
    InputError
        When the text is none of these, or a number is out of range.
    """
    if text is None:
        return None
    word, _, rest = text.strip().partition(":")
    fits, parts = {"fit": False, "fit-channels": True}, rest.split(",") if rest else []
    each = fits.get(parts[0].strip()) if parts else None  # None: nothing is fitted
    try:
        numbers = [float(part) for part in parts[each is not None :]]
    except ValueError:
        raise InputError(f"{_FORMS}; got {text!r}") from None
    match word, each, numbers:
        case "compton", None, _:
            return Compton(tuple(numbers) or (1.0,))
        case "compton", bool(each_channel), []:
            return Compton(None, each_channel)
        case "kernel", None, [ratio, width]:
            return ScatterKernel(ratio, width)
        case "kernel", bool(each_channel), [width]:
            return FittedKernel(width, each_channel)
    raise InputError(f"{_FORMS}; got {text!r}")
