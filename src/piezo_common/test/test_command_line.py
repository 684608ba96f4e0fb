# SPDX-License-Identifier: BSD-3-Clause
"""The frame of the offline commands, as a shell sees it."""

import doctest
import subprocess
import sys

import pytest

from piezo_common import command_line

CHATTY = """
import sys
from piezo_common.command_line import Command

def work(options):
    while True:
        print("a line", flush=True)

sys.modules["chatty"] = sys.modules["__main__"]
sys.exit(Command("chatty", "", lambda parser: None, "chatty:work").main([]))
"""


def test_output_that_nobody_reads_any_more_ends_a_command_without_a_word():
    with subprocess.Popen([sys.executable, "-c", CHATTY], stdout=subprocess.PIPE,
                          stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "a line\n"
        process.stdout.close()
        said = process.stderr.read()
    assert (process.returncode, said) == (141, "")


def test_next_command_is_typed_as_the_present_one_was():
    assert doctest.testmod(command_line).failed == 0


def test_an_option_that_is_missing_is_told_in_one_line(capsys):
    with pytest.raises(SystemExit) as ended:
        command_line.Command(
            "weigh", "", lambda parser: parser.add_argument("--output", required=True), "").main([])
    assert ended.value.code == 2
    assert capsys.readouterr().err == (
        "weigh: the following arguments are required: --output; --help lists the options\n")
