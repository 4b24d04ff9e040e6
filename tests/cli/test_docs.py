"""What docs/cli.md shows is what the commands print."""

import doctest
import re
import shlex
from pathlib import Path

PAGE = Path(__file__).resolve().parents[2] / "docs" / "cli.md"
REAL = "jugglebot/"
SAME = doctest.OutputChecker().check_output


def transcripts():
    """Pairs of a command line and what it printed."""
    for block in re.findall(r"```console\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL):
        for command, output in re.findall(r"^\$ ((?:.*\\\n)*.*)\n((?:(?!\$ ).*\n)*)", block, re.MULTILINE):
            yield command.replace("\\\n", " "), output


def compare(hexopt, command, output):
    answer = hexopt(*shlex.split(command)[1:])
    assert SAME(output, answer.out + answer.err, doctest.ELLIPSIS), f"{command}\n{answer.out}{answer.err}"


def test_commands_print_what_the_page_shows(hexopt):
    lines = [pair for pair in transcripts() if REAL not in pair[0]]
    assert len(lines) == 11
    for command, output in lines:
        compare(hexopt, command, output)


def test_commands_on_real_measurements_print_what_the_page_shows(hexopt, tmp_path, real_data):
    (tmp_path / "jugglebot").symlink_to(real_data)
    (pair,) = [pair for pair in transcripts() if REAL in pair[0]]
    compare(hexopt, *pair)
