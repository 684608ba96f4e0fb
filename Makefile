# SPDX-License-Identifier: BSD-3-Clause
SHELL := bash
# The matrices are small: more threads only wait for each other.
export OPENBLAS_NUM_THREADS ?= 1
# Many short processes import the same libraries, which takes three times as long without bytecode.
unexport PYTHONDONTWRITEBYTECODE
in_environment := source install/setup.bash &&

.PHONY: help setup extras demo test test-repeat mutants style quick long coverage kernels soak bench paced reproduce high-bandwidth published-reference changes recipe measured coupled-scans recording-kinds other-makes diagnose-suite twins calibration constants tables gallery docs clean

help: ## list the targets
	@sed -n 's/^\([a-z-]*\):.*## /\1\t/p' Makefile | expand -t 18

setup: ## make the environment and build the packages; skips what is done
	@tools/setup

extras: ## add what the tests, further file formats and clusters need; skips what is done
	@tools/setup extras

demo: ## identify and control the simulated stage, or that of PLANT (beam); report in runs/demo
	@./run piezo_studies demo $(if $(PLANT),--plant "$(PLANT)")

test: extras ## check the style, then run the unit and the integration tests
	@$(in_environment) tools/tests

style: extras ## check code, docstrings, layers, types and spelling
	@tools/style

quick: extras ## run the numerics of the unit tests, in less than a minute
	@$(in_environment) tools/tests quick

RUNS ?= 10
BUSY ?= 5
test-repeat: extras ## run the tests RUNS times, the last BUSY beside two busy processes; prints a table
	@tools/ten_runs $(RUNS) $(BUSY)

MUTANTS ?= 20
mutants: extras ## change the guards, the laws and the recorder; count what the unit tests let pass
	@$(in_environment) .venv/bin/python benchmarks/mutation_check.py --mutants $(MUTANTS)

long: extras ## run the tests of many draws, and all unit tests under three BLAS kernels
	@$(in_environment) tools/tests long

coverage: extras ## print how much of each module the unit tests run
	@$(in_environment) tools/tests coverage

kernels: setup ## compare the demo's figures under three BLAS kernels; in runs/kernels
	@$(in_environment) .venv/bin/python benchmarks/demo_by_kernel.py

SECONDS_OF_SOAK ?= 900
SEED ?= 1
soak: setup ## kill and stop nodes in runs for SECONDS_OF_SOAK, drawn from SEED; in runs/soak
	@$(in_environment) .venv/bin/python benchmarks/soak.py --seconds $(SECONDS_OF_SOAK) --seed $(SEED)

bench: extras ## measure speed and accuracy beside peers
	-@tools/apart peers  # what could not be installed is named in the table
	@$(in_environment) .venv/bin/python benchmarks/run.py

SECONDS_OF_PACE ?= 600
paced: setup ## pace the loop on board for SECONDS_OF_PACE idle and busy; writes docs/studies/paced_loop.md
	@$(in_environment) .venv/bin/python benchmarks/paced_table.py $(SECONDS_OF_PACE)

DATA ?= ../shared/data
measured: ## identify from measured data in DATA, compare with its published figures; in runs/measured
	@./run piezo_studies measured --data "$(DATA)" --output runs/measured

reproduce: setup ## run the studies of the thesis' chapters 2 to 5; writes the table of docs/reproduction.md
	@$(in_environment) .venv/bin/python -m piezo_studies.thesis

high-bandwidth: setup ## design feedbacks beyond the first mode; writes the tables of docs/high_bandwidth.md
	@$(in_environment) .venv/bin/python -m piezo_studies.high_bandwidth

recipe: setup ## record the simulated stage in shorter ways; writes the tables of docs/recipe.md
	@$(in_environment) .venv/bin/python -m piezo_studies.recording_recipe

coupled-scans: setup ## follow paths on the simulated XY stage; writes the tables of docs/studies/several_axes.md
	@$(in_environment) .venv/bin/python -m piezo_studies.coupled_scans

recording-kinds: setup ## identify from every kind of recording of two foreign stages, for CPU_MINUTES; prints a table
	@$(in_environment) .venv/bin/python -m piezo_studies.recording_kinds $(if $(CPU_MINUTES),--cpu-minutes $(CPU_MINUTES))

MAKES_SEED ?= 0
other-makes: setup ## identify six stages of other makes from files, drawn from MAKES_SEED; in runs/other-makes
	@$(in_environment) .venv/bin/python -m piezo_studies.other_makes --seed $(MAKES_SEED)

published-reference: setup ## follow a published reference by its preview; writes the table of docs/published_reference.md
	@$(in_environment) .venv/bin/python -m piezo_studies.published_reference

changes: setup ## change the stage while a model watches it; writes the table of docs/monitor.md
	@$(in_environment) .venv/bin/python -m piezo_studies.changes_in_operation

CASES ?= 260
EXPERIMENTS ?= 0
diagnose-suite: extras ## diagnose CASES hidden effects drawn from SEED; table in runs/diagnose-suite
	@./run piezo_studies diagnose_suite --cases $(CASES) --seed $(SEED) --experiments $(EXPERIMENTS) $(if $(SCHEDULER),--scheduler $(SCHEDULER))

twins: setup ## decide between effects that resemble each other, by one recording each
	@$(in_environment) .venv/bin/python -m piezo_studies.diagnosis_benchmark.twin_decisions --seed 91

calibration: extras ## diagnose 100 short recordings of a seed; writes docs/studies/diagnosis_rates.md
	@./run piezo_studies diagnose_suite --short --cases 100 --seed 901 --output runs/diagnosis-calibration --page docs/studies/diagnosis_rates.md

tables: setup ## write the tables and the list of rooms in docs that are made from the sources
	@$(in_environment) .venv/bin/python tools/error_table.py
	@$(in_environment) .venv/bin/python tools/stage_table.py
	@$(in_environment) .venv/bin/python tools/import_graph.py
	@$(in_environment) .venv/bin/python tools/file_tables.py
	@$(in_environment) .venv/bin/python tools/constants_table.py

constants: setup ## list the numbers that identification and diagnosis decide by; writes docs/constants.md
	@$(in_environment) .venv/bin/python tools/constants_table.py

gallery: setup ## draw the pictures of docs/gallery.md from runs/demo, which make demo leaves
	@$(in_environment) .venv/bin/python tools/gallery.py runs/demo

docs: extras tables ## make the site of the pages and the API; start at build/docs/index.html
	@tools/apart docs
	@rm -rf docs/api/generated build/docs  # nothing stays of modules that are gone
	@$(in_environment) PYTHONPATH=$$(echo .venv-docs/lib/python*/site-packages):$$PYTHONPATH \
		.venv/bin/python -m sphinx --quiet --fail-on-warning --keep-going docs build/docs
	@echo "written: build/docs/index.html"

clean: ## remove the environment and everything built
	rm -rf .venv .venv-* build docs/api/generated install log
