r"""Mathematics as MathML, made by docutils when the page is built: browsers show it without a script or a network.

docutils reads a part of LaTeX. ``_tidy`` writes what it misreads (``\tfrac12``) or does not know (``…``) in other
words; whatever it refuses then is a warning, hence an error of the build. The bars of a norm keep their height: a
browser would stretch the left one alone where the right one has an exponent. The index of a letter with a hat stands
beside it, where docutils puts it below.
"""

import re
from typing import Any

from docutils import nodes
from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.util.math import get_node_equation_number
from sphinx.writers.html5 import HTML5Translator

_HAT = re.compile(
    r"<munderover>\s*(<mi>\w+</mi>)\s*(<m[in]>\w+</m[in]>|<mrow>(?:(?!<mrow>).)*?</mrow>)\s*"
    r'(<mo stretchy="false">ˆ</mo>)\s*</munderover>',
    re.DOTALL,
)


def _tidy(tex: str) -> str:
    tex = re.sub(r"\\([dt]?frac)\s*(\d)\s*(\d)", r"\\\1{\2}{\3}", tex)
    return tex.replace("…", r"\ldots ")


def _mathml(self: HTML5Translator, node: nodes.Element, *, block: bool) -> str:
    try:
        markup = tex2mathml(_tidy(node.astext().strip()), as_block=block)
        markup = _HAT.sub(r"<msub><mover>\1\3</mover>\2</msub>", markup)
        markup = markup.replace(
            '<mo class="mathopen">‖</mo>', '<mo form="prefix" stretchy="false">‖</mo>'
        )
        return markup.replace(
            "<mo>‖</mo>", '<mo form="postfix" stretchy="false">‖</mo>'
        )
    except MathError as error:
        logging.getLogger(__name__).warning(
            "mathematics: %s in %r", error, node.astext(), location=node
        )
        return self.encode(node.astext())


def visit_math(self: HTML5Translator, node: nodes.Element) -> None:
    self.body.append(
        self.starttag(node, "span", "", CLASS="math notranslate nohighlight")
    )
    self.body.append(_mathml(self, node, block=False) + "</span>")
    raise nodes.SkipNode


def visit_displaymath(self: HTML5Translator, node: nodes.Element) -> None:
    self.body.append(self.starttag(node, "div", CLASS="math notranslate nohighlight"))
    if node["number"]:
        self.body.append(f'<span class="eqno">({get_node_equation_number(self, node)})')
        self.add_permalink_ref(node, "Link to this equation")
        self.body.append("</span>")
    self.body.append(_mathml(self, node, block=True) + "</div>")
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, Any]:
    app.add_html_math_renderer("mathml", (visit_math, None), (visit_displaymath, None))
    app.config.html_math_renderer = "mathml"
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
