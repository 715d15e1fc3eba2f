"""Plots of the documents, drawn from the numbers on their pages."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def effects_page(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(str(ROOT / "bench"))
    return importlib.import_module("effects_page")


def test_bars_are_the_numbers_of_the_table(effects_page: Any) -> None:
    rows = [
        effects_page.Row(
            name,
            3,
            (0.1, 0.2),
            effects_page.Ratio(gain, 0.9, 1.6),
            (1.25, 3.5),
            0.02,
            (1, 2),
            (2, 8),
            9.0,
            3.0,
            None,
        )
        for name, gain in (("fast", 1.5), ("slow", 1.0))
    ]
    text = "\n".join(
        ["# Page", "## Every example", *effects_page.table(rows), "## Shares of the noise", "| `no` |"]
    )
    bars = [effects_page.Bar("slow", 1.0, (1.25, 3.5)), effects_page.Bar("fast", 1.5, (1.25, 3.5))]
    assert effects_page.bars_of(text) == bars


def test_the_effects_page_has_bars_to_draw(effects_page: Any) -> None:
    names = {bar.name for bar in effects_page.bars_of((ROOT / "docs" / "effects.md").read_text())}
    assert "all_effects" in names


def test_the_legend_of_the_effects_plot_covers_no_bar(effects_page: Any) -> None:
    bars = [effects_page.Bar("a_long_name_of_an_example", 1.0 + 0.1 * i, (9.0, 9.0)) for i in range(30)]
    figure = effects_page.draw(bars)
    axes = figure.axes[1]
    legend = axes.get_legend().get_window_extent(figure.canvas.get_renderer())
    assert len(axes.patches) == 2 * len(bars)
    assert not any(legend.overlaps(bar.get_window_extent()) for bar in axes.patches)
    assert figure.bbox.containsx(legend.x0)
    assert figure.bbox.containsx(legend.x1)
    assert figure.bbox.containsy(legend.y0)
    assert figure.bbox.containsy(legend.y1)
