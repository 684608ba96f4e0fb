# SPDX-License-Identifier: BSD-3-Clause
"""The style check finds the words, sentences and first lines that it forbids, and runs in full."""

import importlib.util
import re
import shutil
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[1]
SPEC = importlib.util.spec_from_file_location("prose", ROOT / "tools" / "prose.py")
prose = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(prose)

LONG = "word " * 41 + "."


def of_page(tmp_path, text):
    path = tmp_path / "page.md"
    path.write_text(text)
    return [(finding.line, finding.rule) for finding in prose.of_page(path)]


def of_module(tmp_path, text):
    path = tmp_path / "module.py"
    path.write_text(text)
    return [(finding.line, finding.rule) for finding in prose.of_module(path)]


@pytest.mark.parametrize("words", [
    "The contest is over.", "Two rivals are left.", "Near twins are listed.", "It is judged there.",
    "The feedforward leaves it alone.", "It is left alone.", "It leaves these two alone.",
    "An error that oscillates ever more.", "This is the least of any PI.",
    "It is identified in the second half.", "The mean takes off noise.", "See to the rest.",
])
def test_word_for_which_the_field_has_another_is_found(tmp_path, words):
    assert of_page(tmp_path, f"# Title\n\n{words}\n") == [(3, "word")]


@pytest.mark.parametrize("text", [
    "The alternative models are compared.", "`contest` is a name of code.",
    "```\nsee to the contest\n```", "“the least of any” was said.",
    "[a page](docs/contest.md)", "It sees two modes.",
    "Half a second later.", "- " + "word " * 30 + "\n- " + "word " * 30,
    f"| {'word ' * 30} | {'word ' * 30} |", f"{'word ' * 30}: {'word ' * 30}.",
])
def test_plain_text_and_code_are_not_objected_to(tmp_path, text):
    assert of_page(tmp_path, text) == []


def test_sentence_that_is_too_long_is_found_where_its_paragraph_begins(tmp_path):
    broken = LONG.replace("word word word ", "word word\nword ")
    assert of_page(tmp_path, f"# Title\n\nShort one.\n\n{broken}\n") == [(5, "sentence")]
    assert of_page(tmp_path, f"| a cell | {LONG} |\n") == [(1, "sentence")]


@pytest.mark.parametrize("line", ["(3.20).", "A sine.", "lower case it is.", "No end of it"])
def test_first_line_of_a_docstring_that_is_no_sentence_is_found(tmp_path, line):
    assert of_module(tmp_path, f'def f():\n    """{line}"""\n') == [(2, "first line")]


def test_docstrings_and_messages_are_searched_for_words(tmp_path):
    code = '''"""Do what the module does."""


def f():
    """Return the gain (3.20).

    It takes off the mean.
    """
    raise ValueError(f"the contest of {f} is over")
'''
    assert sorted(of_module(tmp_path, code)) == [(5, "word"), (9, "word")]


def test_table_of_parameters_is_no_sentence(tmp_path):
    table = "    Parameters\n    ----------\n" + "    a : int\n        Of the thing\n" * 20
    assert of_module(tmp_path, f'def f():\n    """Do the thing well.\n\n{table}    """\n') == []


def test_every_room_that_is_still_to_be_done_exists_and_is_not_clean():
    todo = prose.rooms_still_to_do()
    assert todo <= set(prose.rooms())
    for room in todo:
        clean = not any(found for path in prose.modules(room) for found in prose.of_module(path))
        assert not clean or prose.not_imperative(room), (
            f"{room} is clean: take it out of [tool.prose] in pyproject.toml")


def test_whole_tree_is_clean_but_for_the_rooms_still_to_be_done(capsys):
    status = prose.main([])
    assert status == 0, capsys.readouterr().out


def test_every_hook_before_a_commit_is_a_tool_of_the_environment():
    hooks = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text())["repos"]
    assert [repository["repo"] for repository in hooks] == ["local"]
    for hook in hooks[0]["hooks"]:
        assert hook["language"] == "system"
        assert shutil.which(str(ROOT / hook["entry"].split()[0])), hook["entry"]


def test_style_check_of_make_test_runs_every_tool_that_the_hooks_run():
    script = (ROOT / "tools" / "style").read_text()
    assert {"ruff", "mypy", "codespell", "prose.py"} <= set(re.findall(r"[\w.]+", script))
    assert re.search(r"^test: .*\n.*tools/style && tools/tests", (ROOT / "Makefile").read_text(),
                     re.M)
