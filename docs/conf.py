"""How the documentation is built: `make docs` writes it to build/docs, warnings as errors."""

import sys
import tomllib
from pathlib import Path

import jaxtyping  # noqa: F401, so that annotations read Float[Array, "n 6"]

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "_ext"))

project = "prolearn"
author = "The prolearn authors"
release = tomllib.loads((HERE.parent / "pyproject.toml").read_text())["project"]["version"]

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "mathml",
]
exclude_patterns = ["_build", "_ext"]

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

html_theme = "furo"
html_title = f"prolearn {release}"
html_math_renderer = "mathml"
html_show_copyright = False
html_show_sphinx = False
copybutton_prompt_text = "$ "
