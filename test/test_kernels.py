# SPDX-License-Identifier: BSD-3-Clause
"""Commands run under other BLAS kernels, and figures of the demo are compared between them."""

import json
import subprocess
import sys
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
KERNELS = ROOT / "tools" / "kernels.py"
COMPARE = ROOT / "benchmarks" / "demo_by_kernel.py"


def loaded(path, name):
    spec = spec_from_file_location(name, path)
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def kernels():
    return loaded(KERNELS, "kernels_tool")


@pytest.fixture(scope="module")
def working(kernels):
    own, others = kernels.kernels_that_work()
    if not others:
        pytest.skip(f"{kernels.VARIABLE} has no effect on this processor")
    return own, others


@pytest.mark.long
def test_kernels_that_work_differ_from_the_one_in_use(kernels, working):
    own, others = working
    assert not own & set(others)
    assert len(own) + len(others) <= kernels.KERNELS_WANTED
    for kernel in others:
        assert kernels.kernels_in_use(kernel) == {kernel}


@pytest.mark.long
def test_command_runs_under_each_other_kernel_and_a_failure_is_kept(kernels, working):
    _, others = working
    program = f"import os, sys; print(os.environ['{kernels.VARIABLE}']); sys.exit(3)"
    ended = subprocess.run([sys.executable, KERNELS, "--others", sys.executable, "-c", program],
                           capture_output=True, text=True)
    assert ended.returncode == 3
    printed = [line for line in ended.stdout.splitlines() if not line.startswith("kernels: ")]
    assert sorted(printed) == sorted(others)


@pytest.mark.long
def test_results_are_computed_under_each_kernel_that_the_tool_finds(
        kernels, working, under_each_kernel):
    own, others = working
    program = f"import os, numpy; result = {{os.environ['{kernels.VARIABLE}']: numpy.ones(1)}}"
    results = under_each_kernel(program)
    assert {name: list(result) for name, result in results.items()} == {
        kernel: [kernel] for kernel in [*own, *others]}


def test_kernel_that_cannot_be_chosen_is_skipped_and_told(kernels, monkeypatch, capsys):
    # As where the variable is without effect, and where a kernel's instructions are missing.
    monkeypatch.setattr(kernels, "kernels_in_use", lambda requested=None: (
        set() if requested == "SkylakeX" else {"ArmV8"}))
    assert kernels.kernels_that_work() == ({"ArmV8"}, [])
    assert kernels.main(["--others", sys.executable, "-c", "raise SystemExit(1)"]) == 0
    assert "ArmV8 in use" in capsys.readouterr().out


def summary(e_rms_percent, effect="delay"):
    return {
        "tracking": [{"frequency_hz": 40.0, "mode": "composite", "e_rms_percent": e_rms_percent}],
        "diagnosis": {"verdict": "explained", "effects": [
            {"name": effect, "parameters": {"delay_s": 1e-4}}]},
        "wall_s": {"all": e_rms_percent},
    }


def compared(tmp_path, *summaries):
    paths = []
    for number, content in enumerate(summaries):
        paths.append(tmp_path / f"{number}.json")
        paths[-1].write_text(json.dumps(content))
    return subprocess.run([sys.executable, COMPARE, "--summaries", *paths],
                          capture_output=True, text=True)


def test_figures_that_agree_are_listed_with_their_digits(tmp_path):
    ended = compared(tmp_path, summary(0.5), summary(0.50002))
    assert ended.returncode == 0, ended.stderr
    row, = [line.split() for line in ended.stdout.splitlines() if "composite e_rms" in line]
    assert row[-3:] == ["0.5", "0.50002", "4"]
    assert "wall_s" not in ended.stdout


def test_figures_further_apart_than_the_docs_state_fail(tmp_path):
    ended = compared(tmp_path, summary(0.5), summary(0.5), summary(0.6))
    assert ended.returncode == 1
    assert "tracking 40 Hz composite e_rms_percent" in ended.stderr


def test_kernels_that_find_different_effects_fail(tmp_path):
    ended = compared(tmp_path, summary(0.5), summary(0.5, "creep"))
    assert ended.returncode == 1
    assert "the kernels do not agree on diagnosis effects" in ended.stderr
    assert "Traceback" not in ended.stderr
