"""The links of the archives: those of the README lead to the repository, since a package index has no other files."""

import re
from pathlib import Path

from setuptools import setup

ADDRESS = re.search(r'^repository = "(.*)"$', Path("pyproject.toml").read_text(encoding="utf-8"), re.MULTILINE)[1]
SITE = re.sub(r"https://github\.com/([^/]+)/", r"https://\1.github.io/", ADDRESS)
text = re.sub(
    r"(!?)(\[[^\]]*\]\(|(?<=\))\]\()(?!\w+://|#)",
    rf"\1\2{ADDRESS}/<\1>/main/",
    Path("README.md").read_text(encoding="utf-8"),
)
setup(
    long_description=text.replace("/<!>/", "/raw/").replace("/<>/", "/blob/"),
    long_description_content_type="text/markdown",
    project_urls={
        "Repository": ADDRESS,
        "Documentation": SITE,
        "Changelog": f"{ADDRESS}/blob/main/CHANGELOG.md",
        "Issues": f"{ADDRESS}/issues",
    },
)
