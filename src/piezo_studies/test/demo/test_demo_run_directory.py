# SPDX-License-Identifier: BSD-3-Clause
import pytest

from piezo_studies.demo.run_directory import claim_directory


def test_an_earlier_run_is_moved_aside_complete(tmp_path):
    directory = tmp_path / "runs" / "demo"
    assert claim_directory(directory, "first") is None
    for number in range(2):
        (directory / "recording.mcap").write_text(f"run {number}")
        earlier = claim_directory(directory, "next")
        assert (earlier / "recording.mcap").read_text() == f"run {number}"
        assert [path.name for path in directory.iterdir()] == ["run.json"]
    assert len(list(directory.parent.iterdir())) == 3


def test_what_no_run_made_is_refused_and_left_alone(tmp_path):
    (tmp_path / "thesis.txt").write_text("precious")
    with pytest.raises(ValueError, match="something else"):
        claim_directory(tmp_path, "demo")
    assert (tmp_path / "thesis.txt").read_text() == "precious"
    with pytest.raises(ValueError, match="something else"):
        claim_directory(tmp_path / "thesis.txt", "demo")


def test_an_empty_directory_is_taken(tmp_path):
    assert claim_directory(tmp_path, "demo") is None
    assert (tmp_path / "run.json").exists()


def test_a_directory_that_cannot_be_made_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ValueError, match="file/demo cannot be made"):
        claim_directory(tmp_path / "file" / "demo", "demo")
