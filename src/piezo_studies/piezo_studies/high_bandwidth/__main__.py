# SPDX-License-Identifier: BSD-3-Clause
"""Design feedbacks beyond the first mode by every method, and write tables that compare them."""

import argparse
import json
import sys
from pathlib import Path

from piezo_studies.high_bandwidth.trade_off import TITLES, Compared, compare, draw, sections
from piezo_studies.marked_sections import write_sections
from piezo_studies.thesis.identified_stage import identified_stage
from piezo_studies.thesis.pictures import small_png


def main(arguments: list[str] | None = None) -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(prog="high_bandwidth", description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("runs/high_bandwidth"),
                        help="directory of the controller files, from which a run goes on, and of "
                             "what searches found")
    parser.add_argument("--page", type=Path, default=Path("docs/high_bandwidth.md"),
                        help="page whose tables are written again; its picture goes to pictures "
                             "next to it")
    parser.add_argument("--effort", type=float, default=1.0,
                        help="multiplies the number of controllers that are tried")
    options = parser.parse_args(arguments)
    pictures = options.page.parent / "pictures"
    for directory in (options.output, pictures):
        directory.mkdir(parents=True, exist_ok=True)

    model = identified_stage()
    searches = [json.loads(path.read_text(encoding="utf-8"))
                for path in sorted(options.output.glob("search_*.json"))]
    compared: list[Compared] = []

    def take(row: Compared) -> None:
        compared.append(row)
        margin = ("not stable" if row.controller is None
                  else f"margin {row.controller.report['margin_db']:+.1f} dB"
                       f"{'' if row.keeps_bounds else ', beyond a bound'}")
        print(f"{TITLES[row.method]}, light mode {100 * row.light_mode_error:.0f} %, "
              f"{'every stage' if row.of_every_stage else 'model'}: {margin}", file=sys.stderr,
              flush=True)
        # Write the row of each design at once, so that an interrupted run is not lost.
        (pictures / "high_bandwidth.png").write_bytes(small_png(draw(compared)))
        write_sections(options.page, sections(compared, searches))

    compare(model, take, options.output, options.effort)
    print(f"{len(compared)} designs: {options.page}")


if __name__ == "__main__":
    main()
