# SPDX-License-Identifier: BSD-3-Clause
"""One self-contained HTML page of sections with text, tables and pictures: screen, phone, print.

Each picture is drawn once, as a matplotlib figure. The page shows and prints it unchanged, and
links to the numbers of its curves as CSV. If Bokeh is installed, it also has an interactive version
of selected pictures.
"""

import base64
import io
import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

from matplotlib.figure import Figure
from PIL import Image

from piezo_common.interactive_picture import interactive_item, interactive_script, packed
from piezo_common.picture_data import picture_table
from piezo_common.picture_style import to_png

PAGE_DOTS_PER_INCH, PAGE_COLOURS = 140, 128
"""Resolution and palette of a picture at which lines and maps look unchanged."""

MOST_COLUMNS = 4
"""Tables with more columns show each row as a list on narrow screens."""

STYLE = """
:root { color-scheme: light; }
body { font: 1rem/1.5 system-ui, sans-serif; color: #111; background: #fff;
       max-width: 70rem; margin: 0 auto; padding: 1rem; }
h1 { font-size: 1.6rem; line-height: 1.2; }
h1, h2 { overflow-wrap: anywhere; }
h2 { font-size: 1.25rem; margin-top: 2.5rem; border-top: 1px solid #ccc; padding-top: 1rem; }
p { max-width: 45rem; overflow-wrap: anywhere; }
code { font-size: .9em; background: #f2f2f2; padding: 0 .2em; }
.table { overflow-x: auto; margin-bottom: 1.5rem; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { padding: .2rem .7rem; text-align: right; border-bottom: 1px solid #ddd; }
th { border-bottom: 2px solid #111; white-space: nowrap; }
td.text, th.text { text-align: left; }
.pictures { display: grid; gap: 1.5rem;
            grid-template-columns: repeat(auto-fit, minmax(min(100%, 26rem), 1fr)); }
figure { margin: 0; }
.tall { grid-row: span 2; }
.wide { grid-column: 1 / -1; }
figure img { width: 100%; max-width: 38rem; height: auto; }
.wide img { max-width: 54rem; }
figcaption { font-size: .9em; max-width: 38rem; }
.numbers { font-size: .85em; margin: .2rem 0; }
.numbers a, .closer summary { color: #0072b2; cursor: pointer; }
.closer { font-size: .85em; }
@media (max-width: 40rem) {
  body { padding: .6rem; }
  table { font-size: .8rem; width: 100%; }
  th, td { padding: .2rem .35rem; white-space: normal; overflow-wrap: anywhere; }
  th, td:first-child { overflow-wrap: break-word; }
  .many thead { display: none; }
  .many tr { display: block; border-bottom: 1px solid #111; padding: .3rem 0; }
  .many td, .many td.text { display: flex; justify-content: space-between; gap: 1rem;
                            border: 0; padding: .1rem 0; text-align: right; }
  .many td::before { content: attr(data-head); text-align: left; color: #555; }
  .many td:empty { display: none; }
  .many td:first-child { font-weight: bold; }
}
@media print {
  body { max-width: none; font-size: 10pt; padding: 0; }
  .pictures { grid-template-columns: 1fr 1fr; gap: .4rem 1rem; }
  figure img { max-height: 4.4cm; width: auto; max-width: 100%; }
  figure.tall img { max-height: 8.6cm; }
  figure.wide img { max-height: 8cm; }
  p { margin: .4rem 0; }
  table { font-size: 8.5pt; } th, td { padding: .1rem .5rem; }
  .table { overflow: visible; }
  .numbers, .closer { display: none; }
  figure, tr { break-inside: avoid; } figcaption { break-before: avoid; }
  h2 { margin-top: .6rem; padding-top: .4rem; } h2, figcaption { margin-bottom: 0; }
  figcaption { font-size: 8pt; line-height: 1.25; }
  h1, h2, thead { break-after: avoid; } p { orphans: 3; widows: 3; }
}
"""


@dataclass(frozen=True)
class Picture:
    """A picture with a caption of one sentence."""

    name: str
    """Alternative text of the picture."""
    caption: str
    png: bytes

    tall: bool = False
    wide: bool = False
    """A tall picture takes the height of two others, a wide one the whole width."""
    data: str = ""
    """Numbers of its curves as CSV; empty for none."""
    closer: dict[str, Any] | None = None
    """Interactive version for Bokeh, as `interactive_item` returns it."""


@dataclass(frozen=True)
class Section:
    """A section of the page; text in backquotes is shown as code."""

    title: str
    paragraphs: Sequence[str] = ()

    table: Sequence[Sequence[str]] = ()
    """Head row, then the other rows; empty for none."""
    pictures: Sequence[Picture] = ()


def pictured(name: str, figure: Figure, caption: str, tall: bool = False, wide: bool = False,
             closer: bool = False) -> Picture:
    """Return a matplotlib figure as a `Picture` with its numbers, and to be zoomed if `closer`."""
    png = to_png(figure, PAGE_DOTS_PER_INCH, PAGE_COLOURS)
    table = picture_table(figure)
    return Picture(name, caption, png, tall, wide, table.csv(),
                   interactive_item(figure, table.columns) if closer else None)


def render_page(title: str, paragraphs: Sequence[str], sections: Sequence[Section]) -> str:
    """Return the HTML of a page as text, with paragraphs below the title."""
    body = "\n".join([f"<h1>{escape(title)}</h1>", *map(_paragraph, paragraphs),
                      *map(_section, sections)])
    if any(picture.closer for section in sections for picture in section.pictures):
        body += interactive_script()
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{escape(title)}</title>
<style>{STYLE}</style>
</head>
<body>
{body}
</body>
</html>
"""


def _section(section: Section) -> str:
    parts = [f"<section>\n<h2>{escape(section.title)}</h2>", *map(_paragraph, section.paragraphs)]
    if section.table:
        parts.append(_table(section.table))
    if section.pictures:
        parts += ['<div class="pictures">', *map(_figure, section.pictures), "</div>"]
    return "\n".join([*parts, "</section>"])


def _paragraph(text: str) -> str:
    return f"<p>{_inline(text)}</p>"


def _inline(text: str) -> str:
    parts = escape(text).split("`")
    return "".join(f"<code>{part}</code>" if index % 2 else part
                   for index, part in enumerate(parts))


def _table(rows: Sequence[Sequence[str]]) -> str:
    heads, *body = rows
    is_text = [not all(_is_number(row[column]) for row in body) for column in range(len(heads))]
    of_heads = "".join(f"<th{_kind(left)}>{_inline(text)}</th>"
                       for text, left in zip(heads, is_text, strict=True))
    of_rows = "\n".join(_row(row, heads, is_text) for row in body)
    many = " many" if len(heads) > MOST_COLUMNS else ""
    return (f'<div class="table{many}"><table>\n<thead><tr>{of_heads}</tr></thead>\n<tbody>\n'
            f"{of_rows}\n</tbody>\n</table></div>")


def _row(texts: Sequence[str], heads: Sequence[str], is_text: Sequence[bool]) -> str:
    cells = "".join(
        f'<td{_kind(left)} data-head="{escape(head)}">{_inline(text)}</td>'
        for text, head, left in zip(texts, heads, is_text, strict=True))
    return f"<tr>{cells}</tr>"


def _kind(is_text: bool) -> str:
    return ' class="text"' if is_text else ""


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return text in ("", "-")
    return True


def _figure(picture: Picture) -> str:
    kind = "tall" if picture.tall else "wide" if picture.wide else "usual"
    return (f'<figure class="{kind}"><img alt="{escape(picture.name)}" '
            f'src="data:image/webp;base64,{_base64(_webp(picture.png))}">'
            f"<figcaption>{_inline(picture.caption)}</figcaption>"
            f"{_data_link(picture)}{_closer(picture)}</figure>")


def _data_link(picture: Picture) -> str:
    if not picture.data:
        return ""
    file = re.sub(r"\W+", "_", picture.name.lower()).strip("_")
    return (f'<p class="numbers"><a download="{file}.csv.gz" '
            f'href="data:application/gzip;base64,{packed(picture.data)}">'
            "numbers of this picture (CSV, gzip)</a></p>")


def _closer(picture: Picture) -> str:
    if picture.closer is None:
        return ""
    item = packed(json.dumps(picture.closer, separators=(",", ":")))
    return ('<details class="closer"><summary>look closer: zoom, hover, hide curves</summary>'
            f'<div></div><script type="application/gzip">{item}</script></details>')


def _webp(png: bytes) -> bytes:
    """Return a picture without loss in two thirds of the bytes."""
    stream = io.BytesIO()
    with Image.open(io.BytesIO(png)) as picture:
        # Slower methods do not make smaller files of drawn lines.
        picture.convert("RGB").save(stream, "webp", lossless=True, method=2)
    return stream.getvalue()


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode()
