"""The command line that all studies share: ``python -m studies NAME [options]``."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NoReturn

from studies.harness.driver import sweep
from studies.harness.study import Study, StudyError
from studies.harness.task import TaskError

Report = Callable[[Path], Path | None]


class Parser(argparse.ArgumentParser):
    """A parser whose errors are one line."""

    def error(self, message: str) -> NoReturn:
        """Print the line and exit."""
        self.exit(2, f"{self.prog}: {message} (--help lists the options)\n")


def parser(study: Study[Any], *, report: bool = False) -> Parser:
    """The shared options, to which a study may add its own.

    Parameters
    ----------
    study : Study
        Gives the defaults.
    report : bool
        Whether the study has a report, and so the option ``--report-only``.
    """
    options = Parser(prog=f"python -m studies {study.name}", allow_abbrev=False)
    add = options.add_argument
    add("--sets", type=_at_least(1), default=study.sets, metavar="N", help="repetitions of a scenario [%(default)s]")
    add("--seed", type=_at_least(0), default=study.seed, metavar="N", help="root seed [%(default)s]")
    where = options.add_mutually_exclusive_group()
    where.add_argument("--workers", type=_at_least(1), metavar="N", help=f"processes [{_cores()}]")
    where.add_argument("--dask", metavar="ADDRESS", help="run on the Dask scheduler there, say tcp://host:8786")
    add("--out", type=Path, default=Path("results", study.name), metavar="DIR", help="results [%(default)s]")
    add("--resume", action="store_true", help="go on with what is in DIR: a killed run, or more sets")
    add("--only", default="*", metavar="PATTERN", help="only scenarios whose key matches, say 'fixed*'")
    if report:
        add("--report-only", action="store_true", help="run nothing, report on what is in DIR")
    return options


def _cores() -> int:
    return os.cpu_count() or 1


def _at_least(least: int) -> Callable[[str], int]:
    def number(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            raise argparse.ArgumentTypeError(f"{text!r} is not a whole number") from None
        if value < least:
            raise argparse.ArgumentTypeError(f"{value} is less than {least}")
        return value

    return number


def execute(study: Study[Any], options: argparse.Namespace, report: Report | None = None) -> int:
    """Run a study as `options` (of `parser`) ask for, then its report.

    Returns
    -------
    int
        The exit code: 0, or 1 with a line on stderr, or 130 when interrupted.
    """
    name = f"python -m studies {study.name}"
    try:
        if not getattr(options, "report_only", False):
            names = ("sets", "seed", "dask", "resume", "only")
            asked = {key: getattr(options, key) for key in names}
            print(sweep(study, options.out, workers=options.workers or _cores(), **asked))
        if report and (page := report(options.out)):
            print(f"report: {page}")
    except StudyError as error:
        details = error.details if isinstance(error, TaskError) else ""
        print(f"{details}{name}: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print(f"{name}: interrupted; finished chunks are kept, --resume goes on", file=sys.stderr)
        return 130
    return 0


def main(study: Study[Any], argv: Sequence[str] | None = None, report: Report | None = None) -> int:
    """Run a study, and its report, from the command line.

    Parameters
    ----------
    study : Study
        What to run.
    argv : sequence of str, optional
        The options; those of this process unless given.
    report : callable ``(out) -> path``, optional
        Writes the report from the rows in `out`, and returns its page.

    Returns
    -------
    int
        The exit code.
    """
    return execute(study, parser(study, report=report is not None).parse_args(argv), report)
