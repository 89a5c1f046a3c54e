"""What all pictures have in common: colours, letters, ellipses, the room about them."""

from __future__ import annotations

from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import EllipseCollection
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
import numpy as np
from numpy.typing import NDArray

# Okabe and Ito's colours, which colour-blind readers can tell apart.
SKY, BLUE, ORANGE, VERMILION = '#56B4E9', '#0072B2', '#E69F00', '#D55E00'
INK, FAINT, GREY = '#22272E', '#8A939E', '#C9CED6'
STYLE = {
    'font.size': 10.5, 'axes.titlesize': 11.5, 'axes.titlelocation': 'left',
    'axes.labelcolor': INK, 'text.color': INK, 'xtick.color': INK, 'ytick.color': INK,
    'axes.edgecolor': FAINT, 'axes.linewidth': 0.8, 'savefig.facecolor': 'white',
    'legend.frameon': False, 'xtick.major.size': 3.0, 'ytick.major.size': 3.0}
_CHI2_95 = 5.991  # the 95 % point of chi squared with two degrees of freedom


def room(bottom: float = 0.0, top: float = 0.0) -> ConstrainedLayoutEngine:
    """Return a layout that leaves shares of the figure's height free for a legend."""
    return ConstrainedLayoutEngine(rect=(0.0, bottom, 1.0, 1.0 - bottom - top))


def ellipses(ax: Axes, means: NDArray[np.float64], covariances: NDArray[np.float64],
             **looks: object) -> None:
    """Draw the 95 % ellipses of means (k, 2) with covariances (k, 2, 2)."""
    variances, directions = np.linalg.eigh(covariances)
    short, long = 2.0 * np.sqrt(_CHI2_95 * np.maximum(variances, 0.0)).T
    angles = np.degrees(np.arctan2(directions[:, 1, 1], directions[:, 0, 1]))
    ax.add_collection(EllipseCollection(
        long, short, angles, units='xy', offsets=means, offset_transform=ax.transData, **looks))


def save(figure: Figure, file: Path) -> None:
    """Write a figure to a file."""
    FigureCanvasAgg(figure)
    figure.savefig(file, dpi=200)
