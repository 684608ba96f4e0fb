# SPDX-License-Identifier: BSD-3-Clause
"""A shell completes subcommands, options, choices and files of `piezo`."""

import subprocess

import pytest

from piezo_offline.piezo_command import COMMANDS, main

pytest.importorskip("shtab")

COMPLETE = """
source "$1"; shift
function=$(complete -p piezo | sed 's/.*-F \\([^ ]*\\).*/\\1/')
COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); COMP_LINE="$*"; COMP_POINT=${#COMP_LINE}
"$function" piezo "${COMP_WORDS[COMP_CWORD]}" "${COMP_WORDS[COMP_CWORD - 1]}" 2>/dev/null
printf '%s\\n' "${COMPREPLY[@]}"
"""


@pytest.fixture
def completed(tmp_path, capsys):
    assert main(["completion", "bash"]) == 0
    script = tmp_path / "completion.bash"
    script.write_text(capsys.readouterr().out)

    def complete(*words):
        done = subprocess.run(["bash", "-c", COMPLETE, "bash", script, "piezo", *words],
                              capture_output=True, text=True, cwd=tmp_path)
        return {word.strip() for word in done.stdout.split("\n")} - {""}

    return complete


def test_subcommands_are_completed(completed):
    assert completed("") >= set(COMMANDS)
    assert completed("id") == {"identify"}


def test_options_and_choices_of_a_subcommand_are_completed(completed):
    assert completed("design", "--meth") == {"--method"}
    assert completed("design", "--method", "") == {"h_infinity", "pid", "pi"}


def test_files_are_completed_where_a_path_is_read(completed, tmp_path):
    (tmp_path / "model.json").touch()
    assert "model.json" in completed("design", "--model", "mod")


def test_script_for_zsh_holds_the_subcommands(capsys):
    assert main(["completion", "zsh"]) == 0
    script = capsys.readouterr().out
    assert script.startswith("#compdef piezo")
    assert all(name in script for name in COMMANDS)
