"""How pictures of this package look: as those of phantomgen do."""

from phantomgen.figure_style import (
    BASIS_LINES,
    BLUE,
    GRAY,
    MILLI,
    RESULT,
    TRUTH,
    UNIT,
    WIDTH,
    channel_colours,
    few_ticks,
    figure_file,
    plain_minor_ticks,
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
    "few_ticks",
    "figure_file",
    "plain_minor_ticks",
    "write_csv",
]
