"""The command line as a user sees it: arguments in; exit code, output and files out."""

from dataclasses import dataclass

import pytest

from hexopt.cli import main


@dataclass(frozen=True)
class Answer:
    code: int
    out: str
    err: str


@pytest.fixture
def hexopt(capsys, tmp_path, monkeypatch):
    """Run a command line, given as one text or as arguments, in an empty folder."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments):
        words = arguments[0].split() if len(arguments) == 1 else list(map(str, arguments))
        with pytest.raises(SystemExit) as caught:
            main(words)
        out, err = capsys.readouterr()
        return Answer(caught.value.code, out, err)

    return run


@pytest.fixture
def done(hexopt):
    """Run a command line that has to succeed, silent on stderr; its output."""

    def run(*arguments):
        answer = hexopt(*arguments)
        assert (answer.code, answer.err) == (0, "")
        return answer.out

    return run
