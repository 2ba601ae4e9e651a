"""How the documentation is built: `make docs` writes it to build/docs, warnings as errors."""

import gc
import re
import tomllib
from pathlib import Path
from typing import Any

import jaxtyping  # noqa: F401, so that annotations read Float[Array, "n 6"]
from docutils import nodes
from latex2mathml.converter import convert
from sphinx.application import Sphinx
from sphinx.util.math import get_node_equation_number

gc.disable()  # to look through the trees of all pages takes long, and next to nothing is garbage

project = "prolearn"
author = "The prolearn authors"
pyproject = Path(__file__).parents[1] / "pyproject.toml"
release = tomllib.loads(pyproject.read_text())["project"]["version"]

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx_copybutton"]
exclude_patterns = ["_build"]

nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 300

myst_enable_extensions = ["amsmath", "dollarmath", "fieldlist"]
myst_heading_anchors = 3

autodoc_member_order = "bysource"
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented_params"
autodoc_default_options = {"members": True}
napoleon_numpy_docstring = False
napoleon_use_ivar = True
nitpicky = False  # shapes such as "n T 6" are no names

smartquotes_action = "qe"  # and no dashes, which would be made of options' hyphens

html_theme = "furo"
html_title = f"prolearn {release}"
html_math_renderer = "mathml"
html_show_copyright = False
html_show_sphinx = False
copybutton_prompt_text = "$ "


def mathml(formula: str, display: str = "inline") -> str:
    """Convert a LaTeX formula to MathML, with thin spaces around functions and full-size dots."""
    between = r"(?<=</m[in]>)(?=<mi>(?:sin|cos|tan)<)|(?<=<mi>(?:sin|cos|tan)</mi>)(?=<m[in]>)"
    made = re.sub(between, '<mspace width="0.167em" />', convert(formula, display=display))
    return re.sub("<mo>(?=[^<]*</mo></mover>)", '<mo scriptlevel="0">', made)


def inline(translator: Any, node: nodes.math) -> None:
    """Inline formula as MathML, which browsers draw without a network or scripts."""
    translator.body.append(mathml(node.astext()))
    raise nodes.SkipNode


def block(translator: Any, node: nodes.math_block) -> None:
    """Displayed formula as MathML, with its equation number if it has one."""
    translator.body.append(translator.starttag(node, "div", CLASS="math"))
    if node["number"]:
        number = get_node_equation_number(translator, node)
        translator.body.append(f'<span class="eqno">({number})</span>')
    translator.body.append(mathml(node.astext(), "block") + "</div>\n")
    raise nodes.SkipNode


def setup(app: Sphinx) -> None:
    """Offer formulas as MathML as html_math_renderer."""
    app.add_html_math_renderer("mathml", (inline, None), (block, None))
