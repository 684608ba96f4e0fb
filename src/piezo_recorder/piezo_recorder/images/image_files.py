# SPDX-License-Identifier: BSD-3-Clause
"""Files of an image: Gwyddion's formats, HDF5 and PNG."""

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from piezo_common.extras import how_to_install
from piezo_common.gsf import MICRO, write_gsf
from piezo_common.picture_style import label, new_figure, to_png
from piezo_recorder.images.scan_image import ScanImage

SHOWN_PERCENT = (1.0, 99.0)
"""Range of the values that the colours show, so that single pixels do not decide."""


def write_image(image: ScanImage, folder: Path, name: str) -> Iterator[str]:
    """Write an image with its deviations into a folder; yield a sentence for each file."""
    for part, values in (("", image.values), ("_deviation", image.deviation)):
        path = folder / f"{name}{part}.gsf"
        write_gsf(path, image.field(values))
        yield f"written {path}"
    path = folder / f"{name}.png"
    path.write_bytes(to_png(image_figure(image)))
    yield f"drawn {path}"
    for suffix, library, extra, write in OPTIONAL:
        path = folder / f"{name}.{suffix}"
        try:
            write(image, path)
        except ImportError:
            yield f"not written: {path}; {library} is missing: {how_to_install(library, extra)}"
        else:
            yield f"written {path}"


def image_figure(image: ScanImage, title: str = "") -> Figure:
    """Draw an image in coordinates of the stage."""
    frame = image.frame
    figure = new_figure(4.6)
    axes = figure.subplots()
    (left, low), (width, height) = frame.corner_um, frame.size_um
    low_value, high_value = np.nanpercentile(image.values, SHOWN_PERCENT)
    drawn = axes.imshow(image.values, "afmhot", origin="lower", vmin=low_value, vmax=high_value,
                        extent=(left, left + width, low, low + height), interpolation="none")
    label(axes, f"{frame.axes[0]} (um)", f"{frame.axes[1]} (um)", title or frame.path)
    axes.grid(False)
    name = image.signal.removesuffix("_um")
    figure.colorbar(drawn, label=f"{name} ({image.unit})" if image.unit else name, shrink=0.8)
    return figure


def _write_gwy(image: ScanImage, path: Path) -> None:
    """Write a Gwyddion file with the values and their deviation as channels."""
    import gwyfile.objects as gwy

    scale = MICRO if image.unit == "um" else 1.0
    (left, low), (width, height) = image.frame.corner_um, image.frame.size_um
    container = gwy.GwyContainer()
    for channel, (title, values) in enumerate((
            (image.signal, image.values), (f"{image.signal} deviation", image.deviation))):
        container[f"/{channel}/data"] = gwy.GwyDataField(
            scale * values, xreal=MICRO * width, yreal=MICRO * height, xoff=MICRO * left,
            yoff=MICRO * low, si_unit_xy=gwy.GwySIUnit(unitstr="m"),
            si_unit_z=gwy.GwySIUnit(unitstr="m" if image.unit else ""))
        container[f"/{channel}/data/title"] = title
    container.tofile(str(path))


def _write_hdf5(image: ScanImage, path: Path) -> None:
    """Write an HDF5 file with the image, its axes, and the positions that were visited."""
    import h5py

    frame, places_um = image.frame, image.frame.places_um()
    with h5py.File(path, "w") as file:
        file.attrs["path"] = frame.path
        file.attrs["sensor_delay_s"] = frame.sensor_delay_s
        rows, columns = (f"{axis}_um" for axis in reversed(frame.axes))
        for name, values, unit in (
                (rows, places_um[:, 0, 1], "um"), (columns, places_um[0, :, 0], "um"),
                (image.signal, image.values, image.unit),
                (f"{image.signal}_deviation", image.deviation, image.unit),
                ("visited_um", image.visited_um, "um"),
                (f"visited_{image.signal}", image.visited_values, image.unit)):
            file[name] = values
            file[name].attrs["units"] = unit
        for name in (rows, columns):
            file[name].make_scale(name)
        for name in (image.signal, f"{image.signal}_deviation"):
            for dimension, scale in zip(file[name].dims, (rows, columns), strict=True):
                dimension.attach_scale(file[scale])


OPTIONAL: tuple[tuple[str, str, str, Callable[[ScanImage, Path], None]], ...] = (
    ("gwy", "gwyfile", "scans", _write_gwy), ("h5", "h5py", "formats", _write_hdf5))
"""For each file that needs a library: its end, the library, the extra, and what writes it."""
