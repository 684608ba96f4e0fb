# SPDX-License-Identifier: BSD-3-Clause
"""Run the cases through Dask, print the confusion table and write it."""

import json

from distributed import Client, LocalCluster, as_completed

from piezo_common.progress_line import ProgressLine
from piezo_studies.diagnosis_benchmark.calibration import calibrate
from piezo_studies.diagnosis_benchmark.calibration_section import write_section
from piezo_studies.diagnosis_benchmark.cases import draw_cases, draw_cases_all_along
from piezo_studies.diagnosis_benchmark.coverage import coverage
from piezo_studies.diagnosis_benchmark.outcome import as_text, refused, summary
from piezo_studies.diagnosis_benchmark.run_case import clean_model, run_case

CONNECT_S = 10


def run_suite(client, count, seed, progress=None, all_along=False):
    """Run the suite; its result does not depend on where it runs.

    Parameters
    ----------
    client : distributed.Client
    count, seed : int
        Cases, and the seed of everything random.
    progress : callable, optional
        Called with the number of cases done.
    all_along : bool
        Draw single effects alone that were there when the model was identified.

    Returns
    -------
    dict
    """
    cases = (draw_cases_all_along if all_along else draw_cases)(count, seed)
    models = {
        plant: client.submit(clean_model, seed, plant, pure=False)
        for plant in sorted({case.plant for case in cases})
    }
    running = [client.submit(run_case, case, models[case.plant], pure=False) for case in cases]
    for done, _ in enumerate(as_completed(running), start=1):
        if progress is not None:
            progress(done)
    results = [
        _result(case, future) for case, future in zip(cases, running, strict=True)
    ]
    return {"seed": seed, "cases": count, "all_along": all_along, **summary(results),
            "calibration": calibrate(results).document(), "coverage": coverage(results),
            "results": results}


def _result(case, future):
    """Return the result of a case; one that was refused stays in the table, with the reason."""
    if future.status == "finished":
        return future.result()
    return refused(case, future.exception())


def diagnose_cases(options):
    """Run the suite of the options; the exit status is 0 whatever the figures are."""
    line = ProgressLine()

    def show(done):
        line.show("cases", done / options.cases)

    try:
        if options.scheduler:
            client = Client(options.scheduler, timeout=CONNECT_S)
        else:
            client = Client(LocalCluster(threads_per_worker=1, dashboard_address=None))
    except OSError as error:
        raise ValueError(f"no scheduler at {options.scheduler}: {error}") from None
    with client:
        document = run_suite(client, options.cases, options.seed, show, options.all_along)
        if client.cluster is not None:
            client.cluster.close()
    line.clear()
    options.output.mkdir(parents=True, exist_ok=True)
    path = options.output / "table.json"
    path.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    print(as_text(document))
    print("expected calibration error "
          f"{document['calibration']['expected_calibration_error']:.3f}")
    intervals = document["coverage"]
    print(f"{100 * intervals['level']:.0f} % intervals that contain the parameter: "
          f"{intervals['right']} of {intervals['intervals']}")
    if options.page is not None:
        write_section(options.page, document)
    print(f"{options.cases} cases of seed {options.seed}: {path}")
    return 0
