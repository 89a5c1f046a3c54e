"""How pictures look: colours, a style, and a figure's frame."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

# Okabe and Ito's colours, which colour-blind readers can tell apart.
SKY, BLUE, ORANGE, VERMILION, GREEN = '#56B4E9', '#0072B2', '#E69F00', '#D55E00', '#009E73'
INK, FAINT, GREY = '#22272E', '#8A939E', '#C9CED6'
STYLE = {
    'font.size': 10.5, 'axes.titlesize': 11.5, 'axes.titlelocation': 'left',
    'axes.labelcolor': INK, 'text.color': INK, 'xtick.color': INK, 'ytick.color': INK,
    'axes.edgecolor': FAINT, 'axes.linewidth': 0.8, 'savefig.facecolor': 'white',
    'legend.frameon': False, 'xtick.major.size': 3.0, 'ytick.major.size': 3.0}


@contextmanager
def styled() -> Iterator[None]:
    """Draw in this style."""
    with rc_context(STYLE):
        yield


def framed(width: float, height: float, legend: float = 0.32) -> Figure:
    """Return an empty figure, in inches, with room for a legend on top."""
    share = legend / height
    figure = Figure(figsize=(width, height),
                    layout=ConstrainedLayoutEngine(rect=(0.0, 0.0, 1.0, 1.0 - share)))
    FigureCanvasAgg(figure)
    return figure


def legend_on_top(figure: Figure, ax: Axes, columns: int) -> None:
    """Name above the figure what an axes shows."""
    figure.legend(*ax.get_legend_handles_labels(), loc='upper center', ncols=columns)


def open_sides(ax: Axes) -> None:
    """Leave out the frame on top and on the right."""
    ax.spines[['top', 'right']].set_visible(False)
