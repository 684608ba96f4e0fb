# SPDX-License-Identifier: BSD-3-Clause
"""Check the words and sentences of the docs, of docstrings and of messages.

    python tools/prose.py [--count | --done]

The field has words for what the suite does; what says it otherwise is named here with what to say.
A sentence ends before its reader has forgotten its beginning. The first line of a docstring is a
sentence that stands alone. Pages that are written from the sources are checked in the sources.
"""

import argparse
import ast
import re
import subprocess
import sys
import tomllib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
LONGEST_SENTENCE = 40
FEWEST_WORDS_OF_A_FIRST_LINE = 3
GENERATED = {"docs/errors.md", "docs/high_bandwidth.md", "docs/reproduction.md"}

WORDS = [
    (r"contests?|contested", "model comparison"),
    (r"rivals?", "alternative"),
    (r"(near )?twins?", "indistinguishable effect"),
    (r"judg(e|es|ed|ing)", "compare, on the validation set"),
    (r"(tuning|free) columns?", "parameter sensitivities, nuisance regressors"),
    (r"mean[ -]keepers?", "integral feedback"),
    (r"left alone|lea(ve|ves|ving) (\w+ ){0,2}alone", "uncompensated"),
    (r"lead[- ]in", "approach"),
    (r"rungs?", "modal response"),
    (r"ever more", "more and more, or: grows"),
    (r"the least of any", "the best that any ... can attain"),
    (r"(the )?second half", "extended model"),
    (r"(take|takes|taken|took|taking) off", "remove, removed"),
    (r"(see|sees|saw|seen) to", "handle, check"),
]
"""What not to say, as a pattern, and what to say."""

ALLOWED = re.compile(r"`[^`]*`|https?://\S+|“[^”]*”")
"""Code, addresses and quotations: theirs are the words of others."""


class Finding(NamedTuple):
    """Something to mend: where it is, which rule it breaks, and what to do."""

    place: str
    line: int
    rule: str
    text: str


def main(arguments: list[str] | None = None) -> int:
    """Print what is to be mended; return status 1 if there is anything."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    choice = parser.add_mutually_exclusive_group()
    choice.add_argument("--count", action="store_true",
                        help="count the findings of all rooms, also of those still to be done")
    choice.add_argument("--done", action="store_true", help="list the rooms that are done")
    options = parser.parse_args(arguments)
    todo = rooms_still_to_do()
    if options.done:
        print("\n".join(sorted(str(room) for room in rooms() if room not in todo)))
        return 0
    if options.count:
        print_counts(todo)
        return 0
    found = [finding for page in pages() for finding in of_page(page)]
    found += [finding for room in rooms() if room not in todo for path in modules(room)
              for finding in of_module(path)]
    for place, line, rule, text in found:
        print(f"{place}:{line}: {rule}: {text}")
    return 1 if found else 0


def print_counts(todo: set[str]) -> None:
    """Print one line for each room: its findings by rule, and whether it is done."""
    for room in rooms():
        counts = Counter(finding.rule for path in modules(room) for finding in of_module(path))
        counts["D401"] = not_imperative(room)
        told = ", ".join(f"{rule} {count}" for rule, count in sorted(counts.items()) if count)
        print(f"{room}: {told or 'clean'}{' (still to be done)' if room in todo else ''}")


def rooms_still_to_do() -> set[str]:
    """Read the list of rooms from pyproject.toml, ``[tool.prose]``."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    return set(settings["tool"]["prose"]["rooms_still_to_do"])


def rooms() -> list[str]:
    """List the rooms, as paths from the root: each folder of a package that holds modules."""
    folders = {path.parent.relative_to(ROOT) for path in ROOT.glob("src/*/piezo_*/**/*.py")}
    return sorted(folder.as_posix() for folder in folders)


def modules(room: str) -> list[Path]:
    """List the modules of a room, without those of rooms in it."""
    return sorted((ROOT / room).glob("*.py"))


def not_imperative(room: str) -> int:
    """Count the docstrings of a room that do not begin with an imperative."""
    told = subprocess.run(
        [sys.executable, "-m", "ruff", "check", "--select", "D401", "--output-format", "concise",
         *map(str, modules(room))], capture_output=True, text=True, cwd=ROOT, check=False).stdout
    return told.count(": D401 ")


def pages() -> list[Path]:
    """List the pages that people write."""
    found = [*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), ROOT / "CHANGELOG.rst",
             *ROOT.glob("test/*.md")]
    return sorted(path for path in found
                  if path.relative_to(ROOT).as_posix() not in GENERATED)


def of_page(path: Path) -> Iterator[Finding]:
    """Find what to mend on a page, outside its code."""
    place = path.relative_to(ROOT).as_posix() if path.is_relative_to(ROOT) else path.name
    for line, paragraph in paragraphs(path.read_text(encoding="utf-8")):
        yield from of_text(place, line, paragraph)


def paragraphs(text: str) -> Iterator[tuple[int, str]]:
    """Yield each paragraph, list entry and table cell outside code, with its first line."""
    collected: list[str] = []
    first, fenced = 1, False
    for number, line in enumerate([*text.splitlines(), ""], 1):
        fence = line.lstrip().startswith("```")
        begins = re.match(r"\s*([-*#|]|\d+\.|\.\.)(\s|$)", line) or not line.strip() or fence
        if begins and collected:
            yield first, " ".join(collected)
            collected = []
        if fence:
            fenced = not fenced
        elif not fenced and line.lstrip().startswith("|"):
            yield from ((number, cell.strip()) for cell in line.split("|"))
        elif not fenced and line.strip():
            first = first if collected else number
            collected.append(line.strip())


def of_module(path: Path) -> Iterator[Finding]:
    """Find what to mend in the docstrings and messages of a module."""
    place = path.relative_to(ROOT).as_posix() if path.is_relative_to(ROOT) else path.name
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            if (docstring := ast.get_docstring(node)) is not None:
                line = node.body[0].lineno
                yield from of_first_line(place, line, docstring.splitlines()[0])
                yield from of_sentences(place, line, docstring)
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and " " in node.value:
            yield from of_words(place, node.lineno, node.value)


def of_first_line(place: str, line: int, text: str) -> Iterator[Finding]:
    """Object to a first line that is no sentence or says nothing, such as a number alone."""
    words = re.findall(r"[A-Za-z`][\w`.]+", re.sub(r"\([^)]*\)", "", text))
    if len(words) < FEWEST_WORDS_OF_A_FIRST_LINE:
        yield Finding(place, line, "first line", f"{text!r} says too little; write a sentence")
    elif not (text[0].isupper() or text[0] in "`0123456789") or text[-1] not in ".:":
        yield Finding(place, line, "first line",
                      f"{text!r} is no sentence; begin with a capital, end with a full stop")


def of_text(place: str, line: int, text: str) -> Iterator[Finding]:
    """Find words and sentences to mend in plain text."""
    yield from of_words(place, line, text)
    yield from of_sentences(place, line, text)


def without_code(text: str) -> str:
    """Replace code, addresses and quotations by a word."""
    return ALLOWED.sub("x", re.sub(r"\]\([^)]*\)", "]", text))


def of_words(place: str, line: int, text: str) -> Iterator[Finding]:
    """Find words for which the field has others."""
    plain = without_code(text)
    for pattern, instead in WORDS:
        for match in re.finditer(rf"\b({pattern})\b", plain, re.I):
            yield Finding(place, line, "word", f"{match[0]!r}: say {instead}")


def of_sentences(place: str, line: int, text: str) -> Iterator[Finding]:
    """Find sentences that are too long."""
    for paragraph in re.split(r"\n\s*\n", text):
        # The table of parameters in a docstring holds no sentences.
        if re.search(r"^\s*-{3,}\s*$", paragraph, re.M):
            continue
        for sentence in re.split(r"(?<=[.:;?!])\s+|\s-\s", without_code(paragraph)):
            words = sentence.split()
            if len(words) > LONGEST_SENTENCE:
                yield Finding(place, line, "sentence",
                              f"{len(words)} words from {' '.join(words[:5])!r}; make two of it")


if __name__ == "__main__":
    sys.exit(main())
