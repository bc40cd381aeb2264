"""Interactive page for a browser: viewer, meshes and text in a single file that loads nothing else."""

import html
import io
import json
import zipfile
from typing import Any

import pyvista
from trame_vtk.modules.vtk import serializers
from trame_vtk.tools.vtksz2html import write_html

from phantomgen.display.viewer.panes import AXES, INK, MUTED, Pane

_STYLE = f"""
body {{ background: white; color: {INK}; }}
.content {{ position: absolute; inset: 0; }}
.words {{ position: absolute; pointer-events: none; font: SIZEvmin/1.7 "DejaVu Sans", Verdana, sans-serif; }}
.words > * {{ position: absolute; margin: 0; white-space: pre; }}
.title {{ left: 1vw; top: 0.8vmin; font-size: 1.15em; }}
.note {{ left: 1vw; bottom: 1vmin; font-size: 0.9em; color: {MUTED}; }}
.note.high {{ bottom: auto; top: 3.2vmin; }}
.legend {{ left: 1vw; bottom: 1vmin; }}
.legend span {{ display: inline-block; width: 0.8em; height: 0.8em; margin-right: 0.7em; }}
.axes {{ right: 1vw; bottom: 1vmin; font-size: 0.9em; }}
.bar {{ right: 16%; top: 20%; bottom: 20%; width: 2.5%; }}
.bar span {{ position: absolute; left: 130%; transform: translateY(50%); font-size: 0.9em; }}
"""
# The camera of the page knows no parallel projection from the file.
_SCRIPT = """
(function flatten() {
  const window_ = window.global.renderWindow, shown = window_ ? window_.getRenderers().slice(1) : [];
  if (!shown.length) { setTimeout(flatten, 50); return; }
  SCALES.forEach((scale, i) => {
    const camera = shown[i] && shown[i].getActiveCamera();
    if (camera) { camera.setParallelProjection(true); camera.setParallelScale(scale); }
  });
  window_.render();
})();
"""


def page(name: str, plotter: pyvista.Plotter, panes: list[Pane]) -> str:
    """Create the page, with letters as large beside the window as those of the panels.

    Parameters
    ----------
    name : title of the page
    plotter : a window that was drawn for a page
    panes : its panels

    Returns
    -------
    the HTML
    """
    buffer = io.StringIO()
    write_html(_scene(plotter), buffer)
    scales = [pane.camera_scale for pane in panes]
    words = "".join(map(_words, panes))
    script = f"<script>{_SCRIPT.replace('SCALES', json.dumps(scales))}</script>"
    style = _STYLE.replace("SIZE", f"{100 * panes[0].font / min(plotter.window_size):.3g}")
    head, body = buffer.getvalue().split("<body>", 1)
    start, _, rest = head.partition("<title>")
    title = f"<title>{html.escape(name)}</title>"
    head = f"{start}{title}{rest.partition('</title>')[2]}".replace("</head>", f"<style>{style}</style></head>")
    body, end = body.rsplit("</body>", 1)
    return f'{head}<body><div class="content"></div>{words}{body}{script}</body>{end}'


def _scene(plotter: pyvista.Plotter) -> bytes:
    """The window's meshes, colours and cameras, zipped, as the viewer in the page reads them."""
    serializers.initialize_serializers()
    context = serializers.SynchronizationContext()
    context.set_ignore_last_dependencies(True)
    window: Any = plotter.render_window
    scene = serializers.serialize(None, window, serializers.reference_id(window), context, 1)
    arrays = {}
    for entry in serializers.extract_array_hash(scene):
        arrays[entry["hash"]] = {**entry, "content": context.get_cached_data_array(entry["hash"], False)}
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("index.json", json.dumps({"hashes": arrays, "scene": scene}))
    return buffer.getvalue()


def _words(pane: Pane) -> str:
    """The words of one panel, laid over it."""
    x0, y0, x1, y1 = pane.viewport
    place = f"left:{x0:.4%};top:{1 - y1:.4%};width:{x1 - x0:.4%};height:{y1 - y0:.4%}"
    words = pane.words
    where = "note high" if words.legend else "note"
    parts = [f'<p class="title">{html.escape(words.title)}</p>', f'<p class="{where}">{html.escape(words.note)}</p>']
    letters = (f'<b style="color:{colour}">{axis}</b>' for axis, colour in AXES.items())
    parts.append(f'<p class="axes">{" ".join(letters)}</p>')
    if words.legend:
        lines = (f'<span style="background:{colour}"></span>{html.escape(name)}' for name, colour in words.legend)
        parts.append(f'<p class="legend">{"<br>".join(lines)}</p>')
    if words.bar:
        stops = ",".join(words.bar.colours)
        ticks = (f'<span style="bottom:{at:.2%}">{label}</span>' for at, label in words.bar.ticks)
        unit = f'<span style="left:0;bottom:112%">{words.bar.unit}</span>'
        parts.append(
            f'<div class="bar" style="background:linear-gradient(to top,{stops})">{unit}{"".join(ticks)}</div>'
        )
    return f'<div class="words" style="{place}">{"".join(parts)}</div>'
