"""Display of objects in notebooks: a line of text above small pictures."""

import base64
import html
import io
from collections.abc import Sequence

import numpy as np
from jaxtyping import Real

HEIGHT = 120  # pixels on the screen


def thumbnails(words: str, images: Sequence[tuple[str, Real[np.ndarray, "row column"]]]) -> str:
    """Create HTML with gray pictures side by side, black for 0 and white for almost the largest value.

    Parameters
    ----------
    words : line of text
    images : names and values, (row, column)

    Returns
    -------
    the HTML
    """
    pictures = "".join(
        f'<figure style="margin:4px 8px 0 0"><img style="height:{HEIGHT}px;image-rendering:pixelated" '
        f'alt="{html.escape(name)}" src="data:image/png;base64,{_png(image)}">'
        f'<figcaption style="font-size:0.8em">{html.escape(name)}</figcaption></figure>'
        for name, image in images
    )
    return f'<div>{html.escape(words)}<div style="display:flex;flex-wrap:wrap">{pictures}</div></div>'


def _png(image: Real[np.ndarray, "row column"]) -> str:
    from matplotlib.image import imsave  # noqa: PLC0415 - half a second

    known = np.nan_to_num(np.asarray(image, dtype=np.float64))
    top = float(np.quantile(known, 0.999)) or 1.0
    buffer = io.BytesIO()
    imsave(buffer, known, format="png", cmap="gray", vmin=0.0, vmax=top)
    return base64.b64encode(buffer.getvalue()).decode()
