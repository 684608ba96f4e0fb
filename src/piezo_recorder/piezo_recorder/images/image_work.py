# SPDX-License-Identifier: BSD-3-Clause
"""Implementation of `image`: read the recordings; write, print and draw their images."""

import argparse

from piezo_common.gsf import read_gsf
from piezo_recorder.images.image_page import write_images
from piezo_recorder.images.scan_image import image_of
from piezo_recorder.reading.axes import read_axes


def make_images(options: argparse.Namespace) -> None:
    """Make the image of each recording, and the page of all."""
    images = {path.stem: image_of(recording, options.signal)
              for path in options.data for recording in read_axes(path)}
    specimen = options.specimen and read_gsf(options.specimen)
    print("\n".join(write_images(images, options.output, specimen)))
