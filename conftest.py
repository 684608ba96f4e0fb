# SPDX-License-Identifier: BSD-3-Clause
"""What the tests of several packages share: pages looked at in a browser."""

import html
import re
import shutil
import subprocess

import pytest

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
WIDTHS_PX = {"phone": 390, "desk": 1280}
# Each page is laid out in a frame of its width; what does not fit or load is written down.
INSPECTION = """<!DOCTYPE html><title>inspection</title>
<iframe style="width: {width}px; height: 2000px" srcdoc="{page}"></iframe>
<pre id="found"></pre>
<script>
addEventListener("load", () => {{
  const inside = document.querySelector("iframe").contentDocument;
  const found = [];
  if (inside.documentElement.scrollWidth > {width})
    found.push("is " + inside.documentElement.scrollWidth + " px wide");
  for (const image of inside.images)
    if (!image.naturalWidth) found.push("lacks the picture " + image.alt);
  document.getElementById("found").textContent = found.join("\\n");
}});
</script>
"""


@pytest.fixture(scope="session")
def page_faults(tmp_path_factory):
    """Return what is wrong with an HTML page in a headless browser, at the width of a device.

    Faults are a page wider than the device, a missing picture, and messages on the console.
    """
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser is None:
        pytest.skip(f"needs one of {', '.join(BROWSERS)}")
    directory = tmp_path_factory.mktemp("browser")

    def faults(page, device):
        width = WIDTHS_PX[device]
        harness = directory / "page.html"
        harness.write_text(INSPECTION.format(width=width, page=html.escape(page)))
        shown = subprocess.run(
            [browser, "--headless=new", "--no-sandbox", "--disable-gpu", "--dump-dom",
             f"--user-data-dir={directory / 'profile'}", "--enable-logging=stderr",
             f"--window-size={width + 100},2100", "--virtual-time-budget=2000", harness.as_uri()],
            capture_output=True, text=True, timeout=120)
        told = re.search(r'<pre id="found">(.*?)</pre>', shown.stdout, re.S)
        assert told, shown.stderr
        console = re.findall(r"CONSOLE.*", shown.stderr)
        return [*filter(None, html.unescape(told[1]).splitlines()), *console]

    return faults
