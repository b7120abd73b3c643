"""The README in the archives: links of the repository lead to its address, since a package index has no other files."""

import re
from pathlib import Path

from setuptools import setup

ADDRESS = re.search(r'^urls.Repository = "(.*)"$', Path("pyproject.toml").read_text(encoding="utf-8"), re.MULTILINE)[1]
text = re.sub(
    r"(!?)(\[[^\]]*\]\()(?!\w+://|#)", rf"\1\2{ADDRESS}/<\1>/main/", Path("README.md").read_text(encoding="utf-8")
)
setup(
    long_description=text.replace("/<!>/", "/raw/").replace("/<>/", "/blob/"),
    long_description_content_type="text/markdown",
)
