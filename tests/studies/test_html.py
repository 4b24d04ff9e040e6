"""The report is one accessible file, and equal for equal rows."""

import doctest
import re
from html.parser import HTMLParser

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest
from markupsafe import Markup
from toy_study import STUDY

from studies.harness import sweep, tables
from studies.harness.figures import OKABE_ITO, save_figure, use_style
from studies.harness.html import Report, provenance
from studies.harness.tables import number, with_error


@pytest.fixture(autouse=True)
def style():
    with plt.rc_context():
        use_style()
        yield
    plt.close("all")


def drawn():
    figure, axes = plt.subplots()
    axes.plot(np.arange(5), np.arange(5) ** 2, label="squares")
    axes.legend()
    return figure


def frame():
    return pd.DataFrame(
        {"mean": [0.012345, -12.345, np.nan], "n": [10000, 2, 3], "status": ["ok", "<b>", "ok"]},
        index=pd.MultiIndex.from_tuples([("I", "a"), ("I", "b"), ("II", "a")], names=["type", "method"]),
    )


class Balanced(HTMLParser):
    """Fails when a tag is closed that was not opened last."""

    def __init__(self):
        super().__init__()
        self.open, self.seen = [], []

    def handle_starttag(self, tag, attributes):
        self.seen.append((tag, dict(attributes)))
        if tag not in ("meta", "img", "link", "br", "hr"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def written(report, tmp_path, said=None):
    page = report.write(tmp_path / "deep" / "report.html", said).read_text(encoding="utf-8")
    parser = Balanced()
    parser.feed(page)
    assert parser.open == []
    return page, parser.seen


def test_tables_have_captions_heads_units_and_aligned_numbers(tmp_path):
    report = Report("Title")
    report.section("One").table(frame(), "What it says.", units={"mean": "mm"}, formats={"n": "d"})
    page, tags = written(report, tmp_path)
    assert "<caption><span><b>Table 1.</b> What it says.</span></caption>" in page
    heads = re.findall(r"<th([^>]*)>(.*?)</th>", page)
    assert [text for attributes, text in heads if 'scope="col"' in attributes] == [
        "type",
        "method",
        'mean<span class="unit">mm</span>',
        "n",
        "status",
    ]
    rows = [(attributes.strip(), text) for attributes, text in heads if 'scope="row' in attributes]
    assert rows[0] == ('scope="rowgroup" rowspan="2"', "I")
    assert [text for _, text in rows] == ["I", "a", "b", "II", "a"]
    cells = re.findall(r"<td([^>]*)>(.*?)</td>", page)
    assert [text for _, text in cells] == ["0.0123", "10000", "ok", "−12.3", "2", "&lt;b&gt;", "–", "3", "ok"]
    assert [attributes.strip() for attributes, _ in cells] == ['class="num"', 'class="num"', ""] * 3
    assert ("div", {"class": "scroll", "role": "region", "aria-label": "Table 1", "tabindex": "0"}) in tags


def test_levels_of_columns_are_joined(tmp_path):
    columns = pd.MultiIndex.from_product([["paper", "ours"], ["base", "platform"]])
    report = Report("Title")
    report.section("One").table(pd.DataFrame([[1.0] * 4], columns=columns), "Levels.", units={"base": "mm"})
    page, _ = written(report, tmp_path)
    assert re.findall(r'<th scope="colgroup" colspan="2">(\w+)', page) == ["paper", "ours"]
    assert page.count('base<span class="unit">mm</span>') == 2


def test_text_is_escaped_unless_it_is_markup(tmp_path):
    report = Report("A < B", ["x & y"])
    section = report.section("One", "1 < 2", Markup("<em>so</em>"))
    section.items("first", "<second>")
    section.note("mind & step")
    report.fact("3 %", "<failed>")
    page, _ = written(report, tmp_path)
    for text in ("<h1>A &lt; B</h1>", "x &amp; y", "<p>1 &lt; 2</p>", "<p><em>so</em></p>", "<li>&lt;second&gt;</li>"):
        assert text in page
    assert '<p class="note">mind &amp; step</p>' in page
    assert "<dt>&lt;failed&gt;</dt><dd>3 %</dd>" in page


def test_figures_are_embedded_with_caption_and_alternative(tmp_path):
    file = save_figure(drawn(), tmp_path / "figures", "squares")
    report = Report("Title")
    section = report.section("One")
    section.figure(drawn(), "Drawn.", alt='Says "so".')
    section.figure(file, "From a file.", alt="Squares.")
    section.figure(file.with_suffix(".png"), "From another.", alt="Squares.")
    page, tags = written(report, tmp_path)
    images = [attributes for tag, attributes in tags if tag == "img"]
    assert [image["alt"] for image in images] == ['Says "so".', "Squares.", "Squares."]
    kinds = [image["src"].partition(";")[0] for image in images]
    assert kinds == ["data:image/svg+xml", "data:image/svg+xml", "data:image/png"]
    assert "<figcaption><b>Figure 2.</b> From a file.</figcaption>" in page
    assert not re.search(r'(src|href)="(?!data:|#)', page), "one file: nothing is loaded from elsewhere"


def test_equal_figures_are_equal_files(tmp_path):
    for name in ("one", "two"):
        assert save_figure(drawn(), tmp_path / name, "squares") == tmp_path / name / "squares.svg"
    for suffix in ("svg", "png"):
        one, two = ((tmp_path / name / f"squares.{suffix}").read_bytes() for name in ("one", "two"))
        assert one == two
        assert b"Date" not in one
        assert b"date" not in one
    width = int.from_bytes((tmp_path / "one" / "squares.png").read_bytes()[16:20], "big")
    assert width == 7.2 * 150
    assert plt.rcParams["axes.prop_cycle"].by_key()["color"] == list(OKABE_ITO)


def test_the_footer_says_where_the_numbers_come_from(tmp_path):
    sweep(STUDY, tmp_path / "out", sets=20)
    said = provenance(tmp_path / "out")
    assert said["Study"] == "toy"
    assert said["Root seed"] == "5"
    assert said["Sets"] == "20 in each of 2 scenarios, in chunks of 8"
    assert f"numpy {np.__version__}" in said["Versions"]
    assert re.fullmatch(r"\d+ s with 1 workers?, begun 20\d\d-.*", said["Time"])
    sweep(STUDY, tmp_path / "out", sets=24, only="narrow", resume=True)
    sweep(STUDY, tmp_path / "out", sets=24, only="narrow", resume=True)
    assert provenance(tmp_path / "out")["Sets"] == "20 to 24 in each of 2 scenarios, in chunks of 8"
    page, _ = written(Report("Title"), tmp_path, said)
    assert "<dt>Root seed</dt><dd>5</dd>" in page


def test_numbers():
    assert doctest.testmod(tables).failed == 0
    assert doctest.testmod(tables).attempted == 2
    assert number(0.0) == "0.00"
    assert number(np.float64(123.456)) == "123"
    assert number(np.int64(-1234567)) == "−1\u202f234\u202f567"
    assert [number(value) for value in (9.994, 9.996, 99.96)] == ["9.99", "10.0", "100"]
    assert number(1e-5, 2) == "1.0×10⁻⁵"
    assert [number(value) for value in (np.inf, -np.inf, None, pd.NA, True, "text")] == [
        "∞",
        "−∞",
        "–",
        "–",
        "True",
        "text",
    ]
    assert with_error(-0.5, 0.012) == "−0.500 ± 0.012"
    assert with_error(1234.5, 56.0) == "1234 ± 56"
    assert with_error(0.25, np.nan) == "0.250"
    assert with_error(0.0999, 0.00996) == "0.100 ± 0.010"
