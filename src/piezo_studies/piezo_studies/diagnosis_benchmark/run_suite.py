# SPDX-License-Identifier: BSD-3-Clause
"""Run the cases with Dask, and print and write the confusion table."""

import json

from distributed import as_completed

from piezo_common.progress_line import ProgressLine
from piezo_identification.diagnosis.many.many_recordings import cluster_client
from piezo_studies.diagnosis_benchmark.calibration_section import write_section
from piezo_studies.diagnosis_benchmark.cases import draw_cases, draw_cases_all_along
from piezo_studies.diagnosis_benchmark.coverage import coverage
from piezo_studies.diagnosis_benchmark.outcome import as_text, refused, summary, without_experiments
from piezo_studies.diagnosis_benchmark.reliability import calibrate
from piezo_studies.diagnosis_benchmark.run_case import clean_model, run_case
from piezo_studies.diagnosis_benchmark.short_case import draw_short_cases, run_short_case
from piezo_studies.kept_results import KeptResults

DRAWS = {"long": draw_cases, "all-along": draw_cases_all_along, "short": draw_short_cases}
"""Functions that draw the cases, by their kind."""


def run_suite(client, count, seed, progress=None, kind="long", experiments=0, first=None,
              kept=None):
    """Run `count` cases of a kind, a key of `DRAWS`; the result does not depend on the machine.

    By default all cases are run, else the `first` ones in the order in which they are drawn. In
    each but short ones some proposed recordings may be made. `progress` is called with the number
    of cases done. Results are saved at once in the store `kept`, from which the run is resumed.
    """
    cases = DRAWS[kind](count, seed)[:first]
    there = {} if kept is None else kept.results()
    results = {case.number: there[case.number] for case in cases if case.number in there}
    missing = [case for case in cases if case.number not in results]
    models = {
        plant: client.submit(clean_model, seed, plant, pure=False)
        for plant in sorted({case.plant for case in missing})
    }
    run = (run_short_case,) if kind == "short" else (run_case, experiments)
    running = {client.submit(run[0], case, models[case.plant], *run[1:], pure=False): case
               for case in missing}
    for future in as_completed(running):
        case = running[future]
        results[case.number] = _result(case, future)
        if kept is not None:
            kept.add(case.number, results[case.number])
        if progress is not None:
            progress(len(results))
    ordered = [results[case.number] for case in cases]
    before = summary([without_experiments(result) for result in ordered])["outcomes"]
    return {"seed": seed, "cases": count, "kind": kind, "experiments": experiments,
            **summary(ordered), **({"outcomes_before": before} if experiments else {}),
            "calibration": calibrate(ordered).document(), "coverage": coverage(ordered),
            "results": ordered}


def _result(case, future):
    """Return the result of a case; a refused one is included with the reason."""
    if future.status == "finished":
        return future.result()
    return refused(case, future.exception())


def diagnose_cases(options):
    """Run the suite with the given options; the exit status is 0 whatever the figures are."""
    line = ProgressLine()
    asked = min(options.first or options.cases, options.cases)
    conditions = {"cases": options.cases, "seed": options.seed, "kind": options.kind,
                  "experiments": options.experiments}

    def show(done):
        line.show("cases", done / asked)

    with cluster_client(options.scheduler) as client:
        options.output.mkdir(parents=True, exist_ok=True)
        document = run_suite(client, progress=show, first=options.first, count=options.cases,
                             seed=options.seed, kind=options.kind,
                             experiments=options.experiments,
                             kept=KeptResults(options.output / "cases.jsonl", conditions))
        if client.cluster is not None:
            client.cluster.close()
    line.clear()
    path = options.output / "table.json"
    path.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    print(as_text(document))
    print(calibrate(document["results"]).sentence())
    intervals = document["coverage"]
    print(f"{100 * intervals['level']:.0f} % intervals that contain the parameter: "
          f"{intervals['right']} of {intervals['intervals']}")
    if options.page is not None:
        write_section(options.page, document)
    print(f"{asked} cases of seed {options.seed}: {path}")
    return 0
