# SPDX-License-Identifier: BSD-3-Clause
"""`./run` lists every executable with a sentence."""

import importlib.util
import re
import subprocess
from pathlib import Path

ROOT = Path(__file__).parents[1]
SPEC = importlib.util.spec_from_file_location("executables", ROOT / "tools" / "executables.py")
executables = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(executables)


def test_each_executable_is_listed_with_a_sentence_of_its_own():
    listed = executables.listed()
    declared = {(path.parent.name, name) for path in ROOT.glob("src/*/setup.py")
                for name in re.findall(r'"(\w+) = [\w.]+:main"', path.read_text())}
    assert {(package, name) for package, names in listed.items() for name in names} == declared
    sentences = [text for names in listed.values() for text in names.values()]
    assert all(re.fullmatch(r"[A-Z].{10,}\.", text) for text in sentences), sentences
    assert len(set(sentences)) == len(sentences)


def test_run_lists_by_this_program():
    assert "tools/executables.py" in (ROOT / "run").read_text()


def test_run_is_completed_with_packages_then_executables(tmp_path):
    for package, executable in (("piezo_a", "identify"), ("piezo_a", "check"), ("piezo_b", "x")):
        path = tmp_path / "install" / package / "lib" / package / executable
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()

    def completed(*words):
        done = subprocess.run(
            ["bash", "-c", 'source "$1"; shift; COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); '
             '_piezo_run; echo "${COMPREPLY[@]}"', "bash", ROOT / "tools" / "completion.sh",
             "./run", *words], capture_output=True, text=True, cwd=tmp_path, check=True)
        return done.stdout.split()

    assert completed("") == ["piezo_a", "piezo_b"]
    assert completed("piezo_a", "") == ["check", "identify"]
    assert completed("piezo_a", "id") == ["identify"]
    assert completed("piezo_a", "identify", "--") == []
