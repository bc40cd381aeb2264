"""Figures that notebooks show, whatever the backend of matplotlib."""

from io import BytesIO

from matplotlib.figure import Figure


class NotebookFigure(Figure):
    """Figure of matplotlib that a notebook shows as a picture when it is the result of a cell."""

    def _repr_png_(self) -> bytes:
        """Picture for notebooks."""
        content = BytesIO()
        self.savefig(content, format="png")
        return content.getvalue()
