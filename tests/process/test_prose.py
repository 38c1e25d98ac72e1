"""The prose check, on files in a git repository of its own."""

import subprocess

import prose
import pytest


@pytest.fixture
def repository(tmp_path):
    subprocess.run(["git", "init", "--quiet"], cwd=tmp_path, check=True)

    def track(name, text):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
        subprocess.run(["git", "add", name], cwd=tmp_path, check=True)

    return tmp_path, track


@pytest.mark.parametrize("name", ["a.py", "docs/a.md", "a.yaml", "a.toml", "a.js", "a.html", "Makefile"])
def test_a_listed_word_is_reported_with_its_file_and_line(repository, name, capsys):
    root, track = repository
    track(name, "first\nthen Nobody reads\n")  # prose: the word under test
    assert prose.main(root) == 1
    assert capsys.readouterr().out == f"{name}:2: Nobody\n"  # prose: the word under test


@pytest.mark.parametrize(
    "text",
    [
        "a command that comes too\nlate is dropped",
        "lesting, somebodys, nobody_asks",
        "it told the driver",
        "x = 1  # whoever asks  # prose: a quotation",
        "whoever // prose: a quotation",
        "whoever <!-- prose: a quotation -->",
    ],
)
def test_other_words_and_lines_with_a_reason_pass(repository, text, capsys):
    root, track = repository
    track("a.py", text)
    assert prose.main(root) == 0
    assert capsys.readouterr().out == ""


def test_a_marker_without_a_reason_does_not_count(repository):
    root, track = repository
    track("a.py", "x = 1  # whoever  # prose: \n")  # prose: the word under test
    track("a.md", "whoever <!-- prose: -->\n")  # prose: the word under test
    assert prose.main(root) == 1


@pytest.mark.parametrize("text", ["# not heard of\n# late\n", "x was\n  told", "// tried in\n// vain"])
def test_a_phrase_is_found_across_lines_and_spaces(text):
    assert len(prose.found(text)) == 1


def test_untracked_files_other_suffixes_and_the_lab_are_not_searched(repository):
    root, track = repository
    track("docs/lab/a.md", "nobody")  # prose: the word under test
    track("a.csv", "nobody")  # prose: the word under test
    (root / "b.py").write_text("nobody")  # prose: the word under test
    assert prose.main(root) == 0
