"""The window, the film and the laboratory beside each other: Chromium by Playwright, as in test_lab_browser.py."""

import importlib
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("playwright.sync_api", reason='needs pip install -e ".[browser]"')
pytest.importorskip("websockets", reason='needs pip install -e ".[lab]"')

pytestmark = pytest.mark.slow


def test_window_film_and_laboratory_draw_the_same(monkeypatch):
    """Of one moment the three show the same pose and the same colours, to 1/30 of a length; of another moment not."""
    scripts = Path(__file__).parents[1] / "docs" / "site"
    monkeypatch.syspath_prepend(str(scripts))
    gallery = importlib.import_module("gallery")

    def warm(image):  # muscles that contract and fins: where, about the middle, and the shares of red, green and blue
        pixels = np.asarray(image).astype(int)
        rows, columns = np.nonzero(pixels[..., 0] - pixels[..., 2] > 30)
        red = pixels[pixels[..., 0] - pixels[..., 1:].mean(axis=2) > 90]
        mask = np.zeros((400, 400), bool)
        mask[rows - round(rows.mean()) + 200, columns - round(columns.mean()) + 200] = True
        return mask, (red / red.sum(axis=1, keepdims=True)).mean(axis=0)

    def overlap(one, other):
        near = np.pad(other, 8)
        near = np.any([np.roll(near, (i, j), (0, 1)) for i in range(-8, 9, 2) for j in range(-8, 9, 2)], axis=0)
        return (one & near[8:-8, 8:-8]).sum() / one.sum()

    (window, red), *others = map(warm, gallery.three_painters(30))
    earlier, _ = warm(gallery.window_at(28))
    for mask, colour in others:
        assert min(overlap(window, mask), overlap(mask, window)) > 0.95
        np.testing.assert_allclose(colour, red, atol=0.05)
        assert min(overlap(earlier, mask), overlap(mask, earlier)) < 0.9
