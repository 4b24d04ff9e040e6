"""A page of HTML: sections with text, tables and pictures, all in one file."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any

import jinja2
import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

__all__ = ["Page", "Picture", "Section", "picture"]

DPI = 110


@dataclass(frozen=True)
class Picture:
    """A figure as it stands in a page.

    Attributes
    ----------
    source : str
        A PNG as a data URI.
    caption : str
    alt : str
        What it shows, for those who cannot see it.
    """

    source: str
    caption: str
    alt: str


@dataclass
class Section:
    """One headed part of a page; all text is escaped."""

    title: str
    blocks: list[dict[str, Any]] = field(default_factory=list)

    def text(self, text: str) -> None:
        """Add a paragraph."""
        self.blocks.append({"kind": "text", "text": text})

    def note(self, text: str) -> None:
        """Add a paragraph that stands out."""
        self.blocks.append({"kind": "note", "text": text})

    def given(self, pairs: Sequence[tuple[str, str]]) -> None:
        """Add names with what they stand for."""
        self.blocks.append({"kind": "given", "pairs": pairs})

    def pictures(self, *pictures: Picture) -> None:
        """Add pictures, side by side where there is room."""
        self.blocks.append({"kind": "pictures", "pictures": pictures})

    def table(
        self, caption: str, heads: Sequence[tuple[str, str]], rows: Sequence[Sequence[str]], texts: int = 1
    ) -> None:
        """Add a table: heads with their units, rows of cells, of which the first `texts` are no numbers."""
        self.blocks.append({"kind": "table", "caption": caption, "heads": heads, "rows": rows, "texts": texts})


@dataclass
class Page:
    """A title, key numbers, sections, and a line at the foot."""

    title: str
    facts: list[tuple[str, str]] = field(default_factory=list)
    sections: list[Section] = field(default_factory=list)
    footer: str = ""

    def section(self, title: str) -> Section:
        """Add a section, to be filled."""
        self.sections.append(Section(title))
        return self.sections[-1]

    def html(self) -> str:
        """The page as text."""
        environment = jinja2.Environment(
            loader=jinja2.FileSystemLoader(Path(__file__).parent),
            autoescape=True,
            trim_blocks=True,
            lstrip_blocks=True,
            undefined=jinja2.StrictUndefined,
        )
        return environment.get_template("page.html.j2").render(page=self)


def picture(drawn: Axes | Figure, caption: str, alt: str) -> Picture:
    """A drawn figure as PNG; it is closed."""
    figure = drawn if isinstance(drawn, Figure) else drawn.get_figure(root=True)
    assert figure is not None
    with BytesIO() as file:
        figure.savefig(file, format="png", dpi=DPI, metadata={"Software": None})
        text = base64.b64encode(file.getvalue()).decode()
    plt.close(figure)
    return Picture(f"data:image/png;base64,{text}", caption, alt)
