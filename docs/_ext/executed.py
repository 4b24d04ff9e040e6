"""Code that is run when the page is built: the directive ``run`` and the role ``value``.

    ```{run}
    x = 2
    print(x**2)
    ```

shows the code and what it printed; ``{value}`x + 1``` stands for the text of an expression. All code of a page shares
one namespace and runs in one temporary folder, in the order of the page. An error, or a warning, fails the build; where
an error is what the page is about, ``:raises: InputError`` shows it and demands it. ``:hide:`` shows the output
alone; ``:markdown:`` reads the output as markdown, for tables.
"""

import ast
import contextlib
import io
import sys
import tempfile
import traceback
import types
import warnings
from collections.abc import Set
from pathlib import Path
from typing import Any, ClassVar

from docutils import nodes
from docutils.parsers.rst import directives
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment
from sphinx.util.docutils import SphinxDirective, SphinxRole


class _Page:
    """The namespace and the folder of one page."""

    def __init__(self) -> None:
        # a module that can be imported while the page is read: what its code defines can be pickled
        module = sys.modules["page"] = types.ModuleType("page")
        self.names: dict[str, Any] = module.__dict__
        self.folder = tempfile.TemporaryDirectory()

    def run(self, code: str, place: str) -> str:
        """What the code prints; the value of a last line that is an expression is printed too."""
        tree = ast.parse(code, place)
        last = (
            tree.body.pop()
            if tree.body and isinstance(tree.body[-1], ast.Expr)
            else None
        )
        out = io.StringIO()
        with (
            contextlib.chdir(self.folder.name),
            contextlib.redirect_stdout(out),
            warnings.catch_warnings(),
        ):
            warnings.simplefilter("error")
            try:
                exec(compile(tree, place, "exec"), self.names)
                if last is not None:
                    value = eval(
                        compile(ast.Expression(last.value), place, "eval"), self.names
                    )
                    if value is not None:
                        print(value if isinstance(value, str) else repr(value))
            except Exception as error:
                error.__dict__["printed"] = out.getvalue()
                raise
        return out.getvalue()


def _page(env: BuildEnvironment) -> _Page:
    """The page that is being read; it is not kept once the next is read."""
    held = env.temp_data.get("executed_page")
    if held is None:
        held = env.temp_data["executed_page"] = _Page()
        env.metadata[env.docname]["executed"] = True
    return held


def clean(app: Sphinx, doctree: nodes.document) -> None:
    """Remove the folder of a page that has been read."""
    held = app.env.temp_data.get("executed_page")
    if held is not None:
        held.folder.cleanup()


class Run(SphinxDirective):
    """Run the content, and show it with its output."""

    has_content = True
    option_spec: ClassVar = {
        "hide": directives.flag,
        "markdown": directives.flag,
        "raises": directives.unchanged,
    }

    def run(self) -> list[nodes.Node]:
        code = "\n".join(self.content)
        source, line = self.get_source_info()
        wanted = self.options.get("raises")
        try:
            # blank lines before it, so that a traceback names the line of the page
            output = _page(self.env).run("\n" * line + code, f"{Path(source).name}")
        except Exception as error:
            if type(error).__name__ != wanted:
                raise self.error(
                    f"the code of this page fails:\n{traceback.format_exc()}"
                ) from None
            output = f"{error.__dict__['printed']}{wanted}: {error}\n"
        else:
            if wanted:
                raise self.error(f"the code was to raise {wanted}, and did not")
        shown: list[nodes.Node] = (
            []
            if "hide" in self.options
            else [nodes.literal_block(code, code, language="python")]
        )
        if "markdown" in self.options:
            shown += self.parse_text_to_nodes(output)
        elif output.strip():
            text = output.rstrip()
            shown.append(
                nodes.literal_block(
                    text,
                    text,
                    language="text",
                    classes=["output", "raised"] if wanted else ["output"],
                )
            )
        return shown


class Value(SphinxRole):
    """The text of an expression in the page's namespace."""

    def run(self) -> tuple[list[nodes.Node], list[nodes.system_message]]:
        try:
            return [
                nodes.Text(
                    _page(self.env).run(self.text, self.env.docname).rstrip("\n")
                )
            ], []
        except Exception:
            message = self.inliner.reporter.error(
                f"the value {self.text!r} fails:\n{traceback.format_exc()}"
            )
            return [nodes.problematic(self.rawtext, self.rawtext)], [message]


def outdated(
    app: Sphinx,
    env: BuildEnvironment,
    added: Set[str],
    changed: Set[str],
    removed: Set[str],
) -> list[str]:
    """Pages that run code are read anew in each build: the library may have changed."""
    return [name for name, data in env.metadata.items() if "executed" in data]


def setup(app: Sphinx) -> dict[str, Any]:
    app.add_directive("run", Run)
    app.add_role("value", Value())
    app.connect("doctree-read", clean)
    app.connect("env-get-outdated", outdated)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
