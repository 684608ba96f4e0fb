# SPDX-License-Identifier: BSD-3-Clause
"""What the tests of several packages share: CSV files, pages in a browser, pictures in grey."""

import base64
import csv
import fcntl
import gc
import gzip
import html
import importlib.util
import io
import os
import random
import re
import shutil
import socket
import subprocess
import sys
import tempfile
from contextlib import contextmanager
from itertools import chain, combinations
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from matplotlib.colors import to_hex, to_rgb
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator
from PIL import Image
from replaced import replaced
from undrawn import save_point

from piezo_common import report_page, side_by_side
from piezo_common.interactive_picture import interactive_item
from piezo_ros.discovery import prepare_discovery

LONG = bool(os.environ.get("LONG_TESTS"))
DOCS = Path(__file__).parent / "docs"
SHARED = {
    "identification": {
        "test_diagnose_action", "test_diagnose_experiments", "test_examples",
        "test_experiments_recorded", "test_general_references", "test_identify_and_track",
        "test_long_streams", "test_probe_with_nodes", "test_run_supervision", "test_stage_faults"},
    "whole_suite": {
        "test_client_library", "test_impossible_transitions", "test_node_parameters",
        "test_security", "test_stage_tracking", "test_stage_waveforms", "test_two_stages"},
}
"""Files by the fixture that they share, which is made once: those of one run in one process.

What is identified comes with nodes of its own.
"""
# A test that draws does not watch the clock, and draws anew only where `make long` runs it.
settings.register_profile("suite", deadline=None, derandomize=not LONG,
                          suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("suite")

DOMAINS = range(1, 100)
CLAIMS = f"{tempfile.gettempdir()}/piezo_test_domain_{{number}}"
"""Locked by the test process that uses a domain, until it ends."""

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
  const range = inside.createRange();
  for (const cell of inside.querySelectorAll("th, td:first-child"))
    for (const node of cell.childNodes)
      for (const word of node.nodeType === 3 ? node.data.matchAll(/[A-Za-z]+/g) : []) {{
        range.setStart(node, word.index);
        range.setEnd(node, word.index + word[0].length);
        if (range.getClientRects().length > 1) found.push("breaks the word " + word[0]);
      }}
  document.getElementById("found").textContent = found.join("\\n");
}});
</script>
"""

# Okabe and Ito's, which the colour-blind tell apart.
PALETTE = {"#000000", "#e69f00", "#56b4e9", "#009e73", "#f0e442", "#0072b2", "#d55e00", "#cc79a7"}
COARSE_DOTS_PER_INCH = 72
LEAST_LIGHTNESS_DIFFERENCE = 20.0
"""Of L*, 0 to 100, between lines of the same dashes and marker."""
COUNTS = re.compile("number|direction|correlation|with the voltage")
"""How labels of plain numbers begin; all others give a unit in brackets."""


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """Give each file to one process, and all files that are SHARED's of a fixture to the same."""
    from xdist.scheduler import LoadScopeScheduling

    class Scheduling(LoadScopeScheduling):
        def _split_scope(self, nodeid):
            path = nodeid.partition("::")[0]
            return next((fixture for fixture, files in SHARED.items()
                         if Path(path).stem in files), path)

        def schedule(self):
            super().schedule()
            # A process that takes over from one that crashed needs more than its first test, or
            # word that no more comes: it would wait for either for ever.
            for node in self.nodes:
                self._reschedule(node)

    return Scheduling(config, log)


def pytest_collection_modifyitems(config, items):
    """Leave out what is marked ``long``, unless LONG_TESTS is set; SHARED's files come last.

    They share nodes that live from their first use to the end of the run, and take processor time
    by watching each other.
    """
    left_out = [item for item in items if item.get_closest_marker("long") and not LONG]
    if left_out:
        config.hook.pytest_deselected(items=left_out)
        items[:] = [item for item in items if item not in set(left_out)]
    shared = set().union(*SHARED.values())
    items.sort(key=lambda item: item.path.stem in shared)  # all others stay in their order


def pytest_configure():
    """Look for no garbage while tests are collected: it takes a tenth of that time."""
    gc.disable()


def pytest_collection_finish():
    """Let the garbage collector leave alone what lasts as long as the process."""
    gc.freeze()
    gc.enable()


@pytest.fixture(scope="session", autouse=True)
def one_core():
    """Let fits that go side by side take one core: other test files take the others."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(side_by_side, "cores", lambda: 1)
        yield


@pytest.fixture(scope="session")
def domain_of_our_own():
    """Return the number of a ROS domain that nobody else on this machine uses now."""
    with claimed_domain() as number:
        os.environ["ROS_DOMAIN_ID"] = str(number)
        prepare_discovery()  # also for nodes that tests make by rclpy alone
        yield number


@contextmanager
def claimed_domain():
    """Claim a free ROS domain, also against test processes that have started no node yet."""
    for number in random.SystemRandom().sample(DOMAINS, len(DOMAINS)):
        try:
            claim = open(CLAIMS.format(number=number), "a", encoding="utf-8")
        except PermissionError:  # of another user
            continue
        with claim:
            if _is_locked(claim) and _is_free(number):
                yield number
                return
    pytest.exit("every ROS domain of this machine is in use")


def _is_locked(file):
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _is_free(domain):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(("", 7410 + 250 * domain))  # RTPS: of the domain's first participant
        except OSError:
            return False
    return True


@pytest.fixture(scope="session")
def save_csv():
    """Write samples as a CSV file of ours: a path, then times, voltages and displacements."""
    def save(path, time_s, voltage_v, displacement_um):
        np.savetxt(path, np.column_stack([time_s, voltage_v, displacement_um]), fmt="%.6f",
                   delimiter=",", comments="", header="time_s,voltage_v,displacement_um")
        return path

    return save


@pytest.fixture(scope="session")
def under_each_kernel():
    """Compute the same under three kernels of OpenBLAS that this processor runs.

    Give it the source of a program that makes a dictionary ``result`` of arrays; it returns these
    dictionaries by the kernel's name. Skips where there are fewer than three kernels to choose.
    """
    path = Path(__file__).parent / "tools" / "kernels.py"
    spec = importlib.util.spec_from_file_location("kernels_tool", path)
    tool = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(tool)
    own, others = tool.kernels_that_work()
    kernels = [*own, *others]
    if len(kernels) < tool.KERNELS_WANTED:
        pytest.skip(f"this processor and its BLAS run the kernels {kernels} alone: "
                    f"{tool.KERNELS_WANTED} needed")

    def compute(source):
        write = "import sys, numpy; numpy.savez(sys.stdout.buffer, **result)"
        results = {}
        for kernel in kernels:
            run = subprocess.run([sys.executable, "-c", f"{source}\n{write}\n"], timeout=300,
                                 env=tool.environment(kernel), capture_output=True)
            assert run.returncode == 0, run.stderr.decode()
            results[kernel] = dict(np.load(io.BytesIO(run.stdout)))
        return results

    return compute


@pytest.fixture(scope="session")
def page_faults(tmp_path_factory):
    """Return what is wrong with an HTML page in a headless browser, at the width of a device.

    Faults are a page wider than the device, a missing picture, a broken word in a table's head or
    first column, and messages on the console.
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
            capture_output=True, text=True, timeout=300)
        told = re.search(r'<pre id="found">(.*?)</pre>', shown.stdout, re.S)
        assert told, shown.stderr
        console = re.findall(r"CONSOLE.*", shown.stderr)
        return [*filter(None, html.unescape(told[1]).splitlines()), *console]

    return faults


def lightness(color):
    """L* of CIELAB, what is left of a colour in grey."""
    channels = np.asarray(to_rgb(color))
    linear = np.where(channels > 0.04045, ((channels + 0.055) / 1.055) ** 2.4, channels / 12.92)
    luminance = linear @ (0.2126, 0.7152, 0.0722)
    return 116.0 * np.cbrt(luminance) - 16.0 if luminance > 0.008856 else 903.3 * luminance


def dashes_and_marker(line):
    """What tells a line from others without its colour."""
    marker = None if line.get_marker() in ("None", "none", "", None) else line.get_marker()
    return line.get_linestyle(), getattr(line, "_unscaled_dash_pattern", None), marker


def line_faults(axes):
    """Lines of axes that cannot be told apart in grey, or are of no safe colour."""
    lines = [line for line in axes.get_lines() if line.get_xdata(orig=False).size > 2
             or not line.get_label().startswith("_")]
    for line in lines:
        red, green, blue = to_rgb(line.get_color())
        if not red == green == blue and to_hex(line.get_color()) not in PALETTE:
            yield f"{line.get_label()} is {line.get_color()}, which is not in the palette"
    for one, other in combinations(lines, 2):
        if dashes_and_marker(one) == dashes_and_marker(other) and abs(
                lightness(one.get_color()) - lightness(other.get_color())
        ) < LEAST_LIGHTNESS_DIFFERENCE:
            yield f"{one.get_label()} and {other.get_label()} are alike in grey"


def label_faults(figure):
    """Axes of a figure without a label, or with one that has no unit."""
    for direction in "x", "y":
        general = getattr(figure, f"_sup{direction}label")
        for axes in figure.axes:
            shared = getattr(axes, f"get_shared_{direction}_axes")().get_siblings(axes)
            labels = [text for one in shared if (text := getattr(one, f"get_{direction}label")())]
            if general is not None:
                labels.append(general.get_text())
            if axes.get_label() == "<colorbar>" and direction == "x":
                continue
            if not labels:
                yield f"an axis {direction} has no label"
            yield from (f"{text} has no unit" for text in labels
                        if not COUNTS.match(text) and not re.search(r"\(.+\)", text))


@pytest.fixture(scope="session", autouse=True)
def coarse_pictures():
    """Draw pictures of few pixels, with ticks at the ends of the axes, in a fifth of the time."""
    save = Figure.savefig

    def save_coarsely(figure, *given, **options):
        figure._layout_engine = None  # the placeholder of "none" draws every figure twice
        for axes in figure.axes:
            axes.minorticks_off()
            for axis in axes.xaxis, axes.yaxis:
                axis.set_major_locator(FixedLocator(axis.get_view_interval()))
        save(figure, *given, **options | {"dpi": COARSE_DOTS_PER_INCH})

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, "savefig", save_coarsely)
        yield


@pytest.fixture(scope="session")
def picture_faults():
    """Draw, and return what is wrong with the pictures that are saved meanwhile."""
    def faults(draw, *arguments):
        figures, save = [], Figure.savefig

        def keep(figure, *given, **options):
            figures.append(figure)
            save(figure, *given, **options)

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(Figure, "savefig", keep)
            draw(*arguments)
        assert figures, "no picture was drawn"
        return sorted({*chain.from_iterable(map(label_faults, figures)), *chain.from_iterable(
            line_faults(axes) for figure in figures for axes in figure.axes)})

    return faults


@pytest.fixture
def without_pictures(monkeypatch):
    """Make every picture a single point: to draw takes longer than what many tests look at."""
    monkeypatch.setattr(Figure, "savefig", save_point)


@pytest.fixture
def without_ceiling():
    """Train no learner on what a diagnosis leaves: it takes longer than most diagnoses."""
    from short_identification import WITHOUT_CEILING  # here, as it imports the identification

    with replaced(*WITHOUT_CEILING):
        yield


@pytest.fixture(scope="session", autouse=True)
def static_pages():
    """Leave what Bokeh draws out of pages: it takes as long as the pictures."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(report_page, "interactive_item", lambda *_: None)
        yield


@pytest.fixture
def interactive_pages(monkeypatch):
    """Let pages have what Bokeh draws."""
    monkeypatch.setattr(report_page, "interactive_item", interactive_item)


@pytest.fixture
def package_of_page(tmp_path):
    """Lay out the package that a page tells to write, as pip would install it; return its place."""
    def lay_out(page):
        text = (DOCS / page).read_text(encoding="utf-8")
        code = re.search(r"```python\n(.*?)```", text, re.S)[1]
        group, name, target = re.search(
            r'```toml\n\[project\.entry-points\."(.*?)"\]\n(\w+) = "(.*?)"', text).groups()
        module = target.partition(":")[0]
        directory = tmp_path / f"package_{module}"
        metadata = directory / f"{module}-1.0.dist-info"
        metadata.mkdir(parents=True)
        (directory / f"{module}.py").write_text(code)
        (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {module}\nVersion: 1.0\n")
        (metadata / "entry_points.txt").write_text(f"[{group}]\n{name} = {target}\n")
        return directory

    return lay_out


class PageParts:
    """What an HTML page of ours holds: its tables, its pictures, and the numbers behind them."""

    def __init__(self, text):
        # Scripts and data are no links; the page's own text is what is left.
        self.text = re.sub(r"<script.*?</script>", "", text, flags=re.S)
        self.tables = [
            [[html.unescape(re.sub("<.*?>", "", cell))
              for cell in re.findall(r"<t[dh][^>]*>(.*?)</t[dh]>", row)]
             for row in re.findall(r"<tr>(.*?)</tr>", table)]
            for table in re.findall(r"<table>(.*?)</table>", self.text, re.S)]
        self.title = html.unescape(re.search(r"<h1>(.*?)</h1>", self.text)[1])
        self.pictures = {html.unescape(name): base64.b64decode(data) for name, data in re.findall(
            r'<img alt="(.*?)" src="data:image/webp;base64,(.*?)"', self.text)}
        self.external = [link for link in re.findall(r"(?:href|src)=\"(.*?)\"|url\((.*?)\)|@import",
                                                     self.text)
                         if not str(link[0]).startswith(("data:", "#"))]

    def is_picture(self, name):
        """Whether the page shows a picture of this name that is not of one colour."""
        with Image.open(io.BytesIO(self.pictures[name])) as picture:
            return np.ptp(picture.convert("RGB")) > 127

    def numbers(self, name):
        """Return the numbers of a picture by the heads of their columns."""
        figure = re.search(rf'<img alt="{re.escape(html.escape(name))}".*?</figure>', self.text,
                           re.S)[0]
        data = gzip.decompress(base64.b64decode(re.search(
            r"data:application/gzip;base64,(.*?)\"", figure)[1])).decode()
        heads, *rows = csv.reader(io.StringIO(data))
        return {head: [float(row[index]) for row in rows if row[index]]
                for index, head in enumerate(heads)}


@pytest.fixture(scope="session")
def page_parts():
    """Return the parts of a page: give it the file, or the page as text."""
    return lambda page: PageParts(page.read_text() if isinstance(page, Path) else page)
