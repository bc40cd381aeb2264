"""Reports in a browser: no errors, and no scrolling sideways on a phone."""

import re
import shutil
import subprocess

import numpy as np
import pytest

from phantomgen.display.figures.style import figure_file
from phantomgen.display.html import Code, Page, Section, Table, picture, write_page

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
# The page in a frame as wide as a screen; what it measures is written where --dump-dom shows it.
FRAME = """<!doctype html><iframe id="f" width="WIDTH" height="900" style="border:0"></iframe><p id="out"></p><script>
const frame = document.getElementById("f");
frame.onload = () => {
  const root = frame.contentDocument.documentElement;
  document.getElementById("out").textContent = `width=${root.scrollWidth} of=${root.clientWidth}`;
};
frame.srcdoc = new TextDecoder().decode(Uint8Array.from(atob("PAGE"), (c) => c.charCodeAt(0)));
</script>"""


@pytest.mark.skipif(BROWSER is None, reason="no Chromium or Chrome is installed")
@pytest.mark.parametrize("width", [390, 1280])
def test_a_page_has_no_errors_and_fits_the_screen(width, tmp_path):
    import base64

    with figure_file(tmp_path / "a.svg", (4.7, 2.0)) as figure:
        figure.subplots().imshow(np.eye(4))
    table = Table(tuple(f"a long heading {i}" for i in range(9)), (("x",) * 9,), "wide " * 40, "t")
    parts = (picture(tmp_path / "a.svg", "c"), table, Code("code", "y" * 500))
    write_page(Page("a" * 80, "s", (("1", "one"),), (Section("Part", parts),)), tmp_path / "p.html")
    page = base64.b64encode((tmp_path / "p.html").read_bytes()).decode()
    (tmp_path / "frame.html").write_text(FRAME.replace("WIDTH", str(width)).replace("PAGE", page))
    options = ["--headless=new", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path / 'profile'}"]
    options += ["--enable-logging=stderr", "--virtual-time-budget=5000", "--dump-dom", "--window-size=1400,1000"]
    command = [str(BROWSER), *options, f"file://{tmp_path / 'frame.html'}"]
    result = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120)
    measured = re.search(r"width=(\d+) of=(\d+)", result.stdout)
    assert measured is not None, result.stderr[-2000:]
    assert int(measured[1]) <= int(measured[2]) <= width
    assert [line for line in result.stderr.splitlines() if "CONSOLE" in line] == []
