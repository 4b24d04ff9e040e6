"""The commands together, and the one place where an error becomes a line on stderr."""

from __future__ import annotations

import io
import sys
from collections.abc import Sequence
from typing import Annotated, NoReturn

import typer

from .. import __version__
from ..errors import HexoptError
from . import calibrate_command, robots_command, select_command, simulate_command

__all__ = ["app", "main"]

HELP = """Find the true geometry of a Gough–Stewart platform (a hexapod) from measured poses and leg readings.

A calibration in two commands, on simulated measurements:

\b
  hexopt simulate --robot left-hand --lock direction --poses 7 \\
      --nominal-error 0.5cm --out run.csv
  hexopt calibrate run.nominal.toml run.csv --method one-step \\
      --length-unit cm --out found.toml

Every quantity is a number with its unit: 0.5cm, 20um, 0.01deg, 0.002rev.
"""

#: What the library calls an argument, and the command line a flag.
FLAGS = {
    "angle_unit": "--angle-unit",
    "columns": "--column",
    "length_unit": "--length-unit",
    "measured": "--measured",
    "n": "--poses",
    "n_poses": "--poses",
    "orientation": "--orientation",
    "prove": "--prove",
}

#: Arguments that the library advises to give.
ADVICE = {
    " (given=, tolerance=)": " (--given)",
    "(given=)": "(--given)",
    "(given=…)": "(--given)",
    ", narrow the pose ranges (ranges=)": "",
    "given=": "--given",
    "repeat=True": "--repeat",
    "give it limits=Limits(leg_length=…, angles=…), or a condition, accept=": "give it [limits] in its TOML file",
}

app = typer.Typer(
    help=HELP,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
for command in (robots_command, simulate_command, select_command, calibrate_command):
    app.command(command.NAME, help=command.HELP)(command.run)


@app.callback(invoke_without_command=True)
def overview(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Show the version and exit.")] = False,
) -> None:
    """Answer what needs no command."""
    if version:
        print(f"hexopt {__version__}")
    elif context.invoked_subcommand is None:
        print(context.get_help())


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run the command line and exit: 0 for success, 2 with one line on stderr for input that is wrong.

    Parameters
    ----------
    arguments : sequence of str, optional
        By default those of the process.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal without “±” is no reason to fail
    try:
        code = app(arguments, prog_name="hexopt", standalone_mode=False)
    except typer.TyperException as error:
        context = getattr(error, "ctx", None)
        command = context.command_path if context is not None else "hexopt"
        _fail(f"{error.format_message().rstrip('.')}; see {command} --help")
    except HexoptError as error:
        _fail(str(error))
    except OSError as error:  # files are the library's to report; this is the terminal's or the disk's
        _fail(f"the output cannot be written ({error.strerror})")
    sys.exit(code or 0)


def _fail(message: str) -> NoReturn:
    """One line on stderr, in which a setting is called as its flag is."""
    line = " ".join(message.replace("Value error, ", "").split())
    for argument, flag in ADVICE.items():
        line = line.replace(argument, flag)
    setting, colon, rest = line.partition(": ")
    flag = FLAGS.get(setting, setting)
    print(f"hexopt: error: {flag}{colon}{rest}", file=sys.stderr)
    sys.exit(2)
