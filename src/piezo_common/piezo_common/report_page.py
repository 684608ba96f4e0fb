# SPDX-License-Identifier: BSD-3-Clause
"""One self-contained HTML page of sections with text, tables and pictures: screen, phone, print."""

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

from matplotlib.figure import Figure

from piezo_common.picture_style import to_png

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
@media (max-width: 40rem) { body { padding: .6rem; } th, td { padding: .2rem .35rem; }
                            table { font-size: .8rem; } }
@media print { body { max-width: none; font-size: 10pt; padding: 0; }
               .pictures { grid-template-columns: 1fr 1fr; } .table { overflow: visible; }
               figure, tr { break-inside: avoid; } figcaption { break-before: avoid; }
               h1, h2, thead { break-after: avoid; } p { orphans: 3; widows: 3; } }
"""


@dataclass(frozen=True)
class Picture:
    """A picture with the one sentence that says what it shows.

    Attributes
    ----------
    name : str
        Told to those who cannot see it.
    caption : str
    png : bytes
    tall, wide : bool
        Two others fit beside it; none does.
    """

    name: str
    caption: str
    png: bytes
    tall: bool = False
    wide: bool = False


@dataclass(frozen=True)
class Section:
    """A section of the page; text in backquotes is shown as code.

    Attributes
    ----------
    title : str
    paragraphs : sequence of str
    table : list of list of str
        The heads, then the rows; empty for none.
    pictures : sequence of Picture
    """

    title: str
    paragraphs: Sequence[str] = ()
    table: Sequence[Sequence[str]] = ()
    pictures: Sequence[Picture] = ()


def pictured(name: str, figure: Figure, caption: str, tall: bool = False) -> Picture:
    """Return a matplotlib figure as a `Picture`.

    Parameters
    ----------
    name : str
    figure : matplotlib.figure.Figure
    caption : str
    tall : bool
    """
    return Picture(name, caption, to_png(figure), tall)


def render_page(title: str, paragraphs: Sequence[str], sections: Sequence[Section]) -> str:
    """Return the HTML of a page as text.

    Parameters
    ----------
    title : str
    paragraphs : sequence of str
        Below the title.
    sections : sequence of Section
    """
    body = "\n".join([f"<h1>{escape(title)}</h1>", *map(_paragraph, paragraphs),
                      *map(_section, sections)])
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
    is_text = [not _is_number(text) for text in rows[1]]
    heads = _row("th", rows[0], is_text)
    body = "\n".join(_row("td", row, is_text) for row in rows[1:])
    return (f'<div class="table"><table>\n<thead>{heads}</thead>\n<tbody>\n{body}\n</tbody>\n'
            "</table></div>")


def _row(cell: str, texts: Sequence[str], is_text: Sequence[bool]) -> str:
    cells = "".join(f'<{cell} class="text">{_inline(text)}</{cell}>' if left
                    else f"<{cell}>{_inline(text)}</{cell}>"
                    for text, left in zip(texts, is_text, strict=True))
    return f"<tr>{cells}</tr>"


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return text in ("", "-")
    return True


def _figure(picture: Picture) -> str:
    data = base64.b64encode(picture.png).decode()
    kind = "tall" if picture.tall else "wide" if picture.wide else "usual"
    return (f'<figure class="{kind}"><img alt="{escape(picture.name)}" '
            f'src="data:image/png;base64,{data}">'
            f"<figcaption>{_inline(picture.caption)}</figcaption></figure>")
