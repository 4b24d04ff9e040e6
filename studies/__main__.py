"""List the studies, or run one: ``python -m studies [NAME [options]]``.

A study is a folder beside this file with a ``run.py`` that has a ``main(argv) -> int``.
"""

import ast
import importlib
import sys
from collections.abc import Sequence
from pathlib import Path


def find_studies() -> dict[str, str]:
    """Names of the studies and the first lines of their docstrings, read without importing any."""
    studies = {}
    for run in sorted(Path(__file__).parent.glob("*/run.py")):
        package = run.with_name("__init__.py")
        source = (package if package.is_file() else run).read_text(encoding="utf-8")
        studies[run.parent.name] = (ast.get_docstring(ast.parse(source)) or "").partition("\n")[0]
    return studies


def main(argv: Sequence[str]) -> int:
    studies = find_studies()
    if not argv or argv[0] in ("-h", "--help"):
        print("usage: python -m studies NAME [options]     (NAME --help lists the options)\n")
        width = max(map(len, studies), default=0)
        for name, summary in studies.items():
            print(f"  {name:{width}}  {summary}".rstrip())
        return 0
    name, *options = argv
    if name not in studies:
        print(f"studies: there is no study {name!r}, only: {', '.join(studies) or 'none'}", file=sys.stderr)
        return 2
    status: int = importlib.import_module(f"studies.{name}.run").main(options)
    return status


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
