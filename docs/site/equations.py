r"""Hook of the documentation site: equations become MathML when the site is built, so that no script is needed.

The pages write equations as GitHub does: $`x_i`$ within a line, and a block fenced by ```math, numbered by \tag{1}.
Browsers show MathML without help; the font for it, STIX Two Math, is copied from the package ziamath. A command that
cannot be converted is reported as a warning, which a strict build refuses.
"""

import importlib.util
import logging
import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

from latex2mathml.converter import convert
from markdown.extensions import Extension
from markdown.inlinepatterns import InlineProcessor
from mkdocs.structure.files import File, Files

LOG = logging.getLogger("mkdocs.hooks.equations")
FONT = "assets/STIXTwoMath-Regular.ttf"
TAG = re.compile(r"\\tag\{(\d+)\}")
REPAIRS = (
    (re.compile(r"<mo>(&#x0007C;|&#x02016;)</mo>"), r'<mo stretchy="false" lspace="0" rspace="0">\1</mo>'),
    (re.compile(r"<mover>(<m[in]>[^<]*</m[in]>)<mo>(&#x002D9;|&#x000A8;)"), r'<mover accent="true">\1<mo>\2'),
    (re.compile(r'mathvariant="sans-serif"'), 'mathvariant="normal"'),
)
"""What browsers show badly: stretched bars, dots beside their letter, and a font that MathML Core lacks."""


def mathml(latex: str, display: str) -> str:
    """The MathML of an equation, `display` "inline" or "block"."""
    found = convert(latex.strip(), display=display)
    left = [text for text in ElementTree.fromstring(found).itertext() if "\\" in text]
    if left:
        LOG.warning("cannot convert %s in the equation %s", ", ".join(left), latex)
    for pattern, repaired in REPAIRS:
        found = pattern.sub(repaired, found)
    return found


def block(source, language, css_class, options, md, **keywords) -> str:
    """A numbered or plain equation on lines of its own: a custom fence of pymdownx.superfences."""
    number = TAG.search(source)
    shown = f'<div class="shown">{mathml(TAG.sub("", source), "block")}</div>'
    if number is None:
        return f'<div class="equation">{shown}</div>'
    return f'<div class="equation" id="eq-{number[1]}">{shown}<span class="number">({number[1]})</span></div>'


class Inline(InlineProcessor):
    """An equation within a line."""

    def handleMatch(self, m, data):  # noqa: N802  the name that Markdown calls
        return self.md.htmlStash.store(mathml(m[1], "inline")), m.start(0), m.end(0)


class Equations(Extension):
    """Python-Markdown's view of this hook."""

    def extendMarkdown(self, md):  # noqa: N802  the name that Markdown calls
        md.inlinePatterns.register(Inline(r"\$`([^`]+)`\$", md), "equation", 195)  # before code spans, 190


def on_config(config):
    """Let Markdown know equations."""
    config.markdown_extensions.append(Equations())
    fences = config.mdx_configs.setdefault("pymdownx.superfences", {}).setdefault("custom_fences", [])
    fences.append({"name": "math", "class": "equation", "format": block})
    return config


def on_page_content(html: str, page, config, files: Files) -> None:
    """Let MkDocs check links to the anchors of equations: it does not find them itself."""
    page.present_anchor_ids |= set(re.findall(r'id="(eq-\d+)"', html))


def on_files(files: Files, config) -> Files:
    """Ship the font."""
    package = importlib.util.find_spec("ziamath").submodule_search_locations[0]
    font = Path(package, "fonts", Path(FONT).name)
    files.append(File.generated(config, FONT, abs_src_path=str(font)))
    return files
