# SPDX-License-Identifier: BSD-3-Clause
"""Follow a published reference with several previews, and write the page with their errors."""

import argparse
from pathlib import Path

from piezo_studies.published_reference.by_preview import compare
from piezo_studies.published_reference.page import page
from piezo_studies.thesis.identified_stage import identified_stage


def main(arguments: list[str] | None = None) -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(prog="published_reference", description=__doc__)
    parser.add_argument("--page", type=Path, default=Path("docs/published_reference.md"),
                        help="page that is written")
    options = parser.parse_args(arguments)
    rows = compare(identified_stage())
    options.page.write_text(page(rows), encoding="utf-8")
    print(f"{len(rows)} runs: {options.page}")


if __name__ == "__main__":
    main()
