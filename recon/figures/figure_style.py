"""How pictures of this package look: as those of phantomgen do."""

from phantomgen.display.figures.style import (
    BASIS_LINES,
    BLUE,
    GRAY,
    MILLI,
    RESULT,
    TRUTH,
    UNIT,
    WIDTH,
    channel_colours,
    decades_or_zero,
    few_ticks,
    figure_file,
    write_csv,
)

__all__ = [
    "BASIS_LINES",
    "BLUE",
    "GRAY",
    "MILLI",
    "RESULT",
    "TRUTH",
    "UNIT",
    "WIDTH",
    "channel_colours",
    "decades_or_zero",
    "few_ticks",
    "figure_file",
    "write_csv",
]
