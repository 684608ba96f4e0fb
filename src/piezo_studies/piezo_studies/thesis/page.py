# SPDX-License-Identifier: BSD-3-Clause
"""The page of the reproduction, as Markdown."""

from piezo_studies.thesis.studies import CAPTIONS
from piezo_studies.thesis.table import as_markdown

INTRODUCTION = """\
# Reproduction of the thesis, chapters 2 to 5

Written by `make reproduce`; do not edit.

This page repeats every numerical study of chapters 2 to 5 and of the appendix. The table has the
figure of the thesis beside ours. A dash stands where the thesis gives no figure. The remark says
why a figure does not come out, or what ours is.

Where the thesis measured its stage, we measure the simulated one. Its dynamics are those that
chapter 4 identified, and its sensor has the same noise of 9 nm. Its hysteresis and its drift
differ from those of the thesis. The thesis itself simulates in sections 2.2.4, 2.3.3 and 4.6; we
simulate the same plants with the same noise.

Errors are simulation errors by the noisy sensor unless the row says otherwise. The error of a
density is its difference from the true density. Closed loops run with the model that was identified
in 4.7.1, under an offset of 2.1 um, a drift of 50 nm/s, the sensor's noise, and one tick of
computing time. "Composite" is the 40 kHz feedforward with the 1 kHz H-infinity feedback. Ms is the
peak sensitivity. Learning begins with models that are 5 % off, without offset and drift. The
[glossary](glossary.md) explains the terms.
"""


def page(rows):
    """Return the page with the table of rows.

    Parameters
    ----------
    rows : list of Row
    """
    pictures = "\n\n".join(
        f"**Fig. {figure}.** {caption}\n\n"
        f"![Answer to figure {figure}](pictures/reproduction/figure_{figure}.png)"
        for figure, caption in CAPTIONS.items()
    )
    return f"{INTRODUCTION}\n## Figures\n\n{as_markdown(rows)}\n\n## Pictures\n\n{pictures}\n"
