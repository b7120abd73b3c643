"""The built site in a browser, on a desktop and on a phone: nothing is too wide, too small, missing or dead.

It needs the extras [docs], [lab] and [browser], and Chromium: pytest -m slow -n 0 tests/test_pages.py
"""

import re
import subprocess
import sys
from pathlib import Path
from urllib.parse import unquote, urldefrag, urlsplit

import pytest
from pages import ROOT

for module, extra in (("playwright.sync_api", "browser"), ("mkdocs", "docs"), ("websockets", "lab")):
    pytest.importorskip(module, reason=f'needs pip install -e ".[{extra}]"')

from test_lab_browser import SIZES, browser  # noqa: F401 - the fixture

pytestmark = pytest.mark.slow
SMALLEST = 9.0  # pixels: text of a chart
SEEN = """() => {
  const all = (which) => [...document.querySelectorAll(which)];
  const scrolls = (e) => e && (/auto|scroll/.test(getComputedStyle(e).overflowX) || scrolls(e.parentElement));
  const wide = (e) => { const { width, right } = e.getBoundingClientRect(); return width && right > innerWidth + 1; };
  return {
    over: document.documentElement.scrollWidth - innerWidth,
    wide: all("main *, body > *").filter((e) => wide(e) && !scrolls(e.parentElement)).map((e) => e.outerHTML),
    images: [...document.images].map((i) => [i.src, i.complete && i.naturalWidth > 0, i.width, i.closest("a")?.href]),
    links: all("a[href]").map((a) => [a.href, a.textContent.trim()]),
    ids: all("[id], a[name]").flatMap((e) => [e.id, e.name]).filter(String),
  };
}"""


def local(url: str) -> Path:
    """The file that a URL of the disk names."""
    return Path(unquote(urlsplit(url).path))


def text_height(chart: Path, width: float) -> float:
    """Pixels of the smallest text of an SVG that is shown so many pixels wide; inf without text."""
    drawn = chart.read_text("utf-8")
    sizes = [float(size) for size in re.findall(r"font(?:-size)?: [^;\"]*?([\d.]+)px", drawn)]
    return min(sizes, default=float("inf")) * width / float(re.search(r'viewBox="0 0 ([\d.]+)', drawn)[1])


def faults(site: Path, browser) -> list[str]:  # noqa: F811
    """What is wrong on the pages of a site, each with its page."""
    found, links, ids, tab = [], [], {}, browser.new_page()
    for path in sorted({*site.rglob("*.html")} - {site / "404.html"}):  # its links count from a server's root
        name = path.relative_to(site).as_posix()
        for device, size in SIZES.items():
            tab.set_viewport_size(size)
            tab.goto(path.as_uri())
            seen = tab.evaluate(SEEN)
            if seen["over"] > 1 or seen["wide"]:
                found.append(f"{name}: too wide on a {device} by {seen['over']} px: {''.join(seen['wide'][:1])[:80]}")
            for src, loaded, width, link in seen["images"]:
                if not loaded:
                    found.append(f"{name}: {src} does not load")
                elif re.match(r"file:.*\.svg$", src) and link != src and text_height(local(src), width) < SMALLEST:
                    found.append(f"{name}: text of {src} is less than {SMALLEST} px high on a {device}")
        links += [(name, *link) for link in seen["links"] if link[0].startswith("file:")]
        ids[path.as_uri()] = {"", *seen["ids"]}
    for name, link, text in links:
        page, anchor = urldefrag(link)
        if unquote(anchor) not in ids.get(page, {anchor}) or not local(page).is_file():
            found.append(f"{name}: {link} leads nowhere")
        if "#eq-" in link and (number := re.fullmatch(r"(?:eq\. )?\(?(\d+)\)?", text)) and anchor != f"eq-{number[1]}":
            found.append(f"{name}: equation {text} leads to {anchor}")
    return list(dict.fromkeys(found))


def test_site(browser, tmp_path):  # noqa: F811
    """Every page of the site is without a fault."""
    command = [sys.executable, "-m", "mkdocs", "build", "-q", "-d", str(tmp_path)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    assert faults(tmp_path, browser) == []


def test_faults_are_found(browser, tmp_path):  # noqa: F811
    """A fault of every kind is found."""
    svg = '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 648 9" style="font: 9px"/>'
    (tmp_path / "chart.svg").write_text(svg)
    links = '<a href="#dead">a</a><a href="dead.html">a</a><a id="eq-1" href="#eq-1">(2)</a><img src="dead.png">'
    (tmp_path / "page.html").write_text(f'<main style="width: 2000px">{links}<img src="chart.svg" width="300"></main>')
    told = "\n".join(faults(tmp_path, browser))
    for what in ("too wide", "px high", "#dead leads", "dead.html leads", "(2) leads to eq-1", "dead.png does not"):
        assert what in told
