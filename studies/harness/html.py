"""A report in one HTML file: sections, tables, figures, and where the numbers come from."""

from __future__ import annotations

import base64
import json
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any

import jinja2
import matplotlib as mpl
import pandas as pd
from matplotlib.figure import Figure

from studies.harness.figures import save_figure
from studies.harness.store import read_manifest
from studies.harness.tables import Format, table

_LARGEST_SVG = 1_000_000  # bytes, from which a figure of very many points is embedded as PNG instead


@dataclass
class Section:
    """One headed part of a report. Text is escaped, unless it is `markupsafe.Markup`."""

    title: str
    blocks: list[dict[str, Any]] = field(default_factory=list)

    def text(self, *paragraphs: str) -> None:
        """Add paragraphs."""
        self.blocks += [{"kind": "text", "text": text} for text in paragraphs]

    def note(self, text: str) -> None:
        """Add a paragraph that stands out: a limitation, or what went wrong."""
        self.blocks.append({"kind": "note", "text": text})

    def items(self, *items: str) -> None:
        """Add a list."""
        self.blocks.append({"kind": "items", "items": items})

    def table(
        self,
        frame: pd.DataFrame,
        caption: str,
        *,
        units: Mapping[Hashable, str] | None = None,
        formats: Mapping[Hashable, Format] | None = None,
        digits: int = 3,
    ) -> None:
        """Add a table.

        Parameters
        ----------
        frame : pandas.DataFrame
            The cells. A named index heads the rows; levels of an index or of columns are joined cells.
        caption : str
            What the table says, above it.
        units : mapping of column to str, optional
            Units, below the heads of the columns (or of index levels).
        formats : mapping of column to format, optional
            A format specification such as ``".2f"``, or a function to a string.
        digits : int
            Significant digits of the other columns of floats.
        """
        cells = table(frame, units or {}, formats or {}, digits)
        self.blocks.append({"kind": "table", "caption": caption, **cells})

    def figure(self, figure: Figure | str | Path, caption: str, *, alt: str) -> None:
        """Add a figure, drawn or from an SVG or PNG file; `alt` describes it to those who cannot see it."""
        kind, data = _image(figure)
        source = f"data:image/{kind};base64,{base64.b64encode(data).decode()}"
        self.blocks.append({"kind": "figure", "source": source, "caption": caption, "alt": alt})

    def drawn(self, figure: Figure, out: Path, name: str, caption: str, alt: str) -> None:
        """Add a figure, and keep it as a file in ``out/figures``."""
        save_figure(figure, out / "figures", name)
        self.figure(figure, caption, alt=alt)


@dataclass
class Report:
    """A page: a title, a summary, key numbers, and sections.

    Parameters
    ----------
    title : str
        The heading.
    summary : sequence of str
        Paragraphs below it: what was found.
    """

    title: str
    summary: Sequence[str] = ()
    facts: list[tuple[str, str]] = field(default_factory=list)
    sections: list[Section] = field(default_factory=list)

    def fact(self, value: str, label: str) -> None:
        """Add a key number to the row below the summary."""
        self.facts.append((value, label))

    def section(self, title: str, *paragraphs: str) -> Section:
        """Add a section, and return it to be filled."""
        section = Section(title)
        section.text(*paragraphs)
        self.sections.append(section)
        return section

    def write(self, path: str | Path, provenance: Mapping[str, str] | None = None) -> Path:
        """Write the page.

        Parameters
        ----------
        path : path
            The file; its folder is made if need be.
        provenance : mapping of str to str, optional
            What the footer says; see `provenance`.

        Returns
        -------
        pathlib.Path
            The file.
        """
        path = Path(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        loader = jinja2.FileSystemLoader(Path(__file__).parent)
        options = {"trim_blocks": True, "lstrip_blocks": True, "undefined": jinja2.StrictUndefined}
        environment = jinja2.Environment(loader=loader, autoescape=True, **options)  # type: ignore[arg-type]
        page = environment.get_template("report.html.j2").render(report=self, provenance=dict(provenance or {}))
        path.write_text(page, encoding="utf-8")
        return path


def provenance(out: str | Path) -> dict[str, str]:
    """Where the rows of a sweep come from: the footer of its report."""
    manifest, log = read_manifest(out), Path(out) / "runs.jsonl"
    runs = [json.loads(line) for line in log.read_text(encoding="utf-8").splitlines()] if log.is_file() else []
    sets = sorted({scenario["sets"] for scenario in manifest["scenarios"].values()})
    said = {
        "Study": manifest["study"],
        "Root seed": str(manifest["seed"]),
        "Sets": f"{' to '.join(str(number) for number in dict.fromkeys((sets[0], sets[-1])))} in each of "
        f"{len(manifest['scenarios'])} scenarios, in chunks of {manifest['chunk_size']}",
        "Versions": ", ".join(f"{name} {version}" for name, version in manifest["versions"].items()),
        "Configuration": manifest["configuration"],
    }
    if made := [run for run in runs if run["made"]]:
        seconds = sum(run["seconds"] for run in made)
        said["Command"] = made[-1]["command"]
        said["Time"] = f"{seconds:.0f} s with {made[-1]['workers']}, begun {made[0]['started']}"
    return said


def _image(figure: Figure | str | Path) -> tuple[str, bytes]:
    if not isinstance(figure, Figure):
        path = Path(figure)
        return {".svg": "svg+xml", ".png": "png"}[path.suffix], path.read_bytes()
    with BytesIO() as svg, BytesIO() as png, mpl.rc_context({"svg.hashsalt": "studies"}):
        figure.savefig(svg, format="svg", metadata={"Date": None, "Creator": None})
        if len(svg.getvalue()) <= _LARGEST_SVG:
            return "svg+xml", svg.getvalue()
        figure.savefig(png, format="png", dpi=150, metadata={"Software": None})
        return "png", png.getvalue()
