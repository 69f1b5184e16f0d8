"""The look that all figures share.

Line style and marker tell the curves apart where colour cannot.
"""

import io

import matplotlib.figure
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

# Okabe and Ito's palette without yellow: distinct for every kind of colour vision.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
LINE_STYLES = (
    "-",
    (0, (5, 1.5)),
    (0, (1, 1)),
    (0, (7, 1.5, 1, 1.5)),
    (0, (3, 1, 1, 1, 1, 1)),
    (0, (9, 3)),
)
MARKERS = ("o", "s", "^", "D", "v", "P")
VERDICT_STYLES = {
    "asymptotically stable": {"marker": "o", "color": "#0072B2"},
    "neutral": {"marker": "s", "color": "#009E73"},
    "unstable": {"marker": "X", "color": "#D55E00"},
    "none found": {"marker": "v", "color": "#555555"},
    "undecided": {"marker": "d", "color": "#CC79A7"},
}
INK = "#333333"
#: Of figures, and of pages of notebooks.
DPI, SHOWN_DPI = 200, 96
#: Most curves that a legend names.
MOST_NAMED = 20


class Figure(matplotlib.figure.Figure):
    """A figure that notebooks show although it is none of pyplot's."""

    def _repr_png_(self):
        """Its picture, and how large to show it [pixels of the page]."""
        stream = io.BytesIO()
        self.savefig(stream, format="png")
        width, height = (round(SHOWN_DPI * inches) for inches in self.get_size_inches())
        return stream.getvalue(), {"width": width, "height": height}


def series_style(i: int) -> dict[str, object]:
    """Colour and line style of the i-th curve."""
    return {"color": COLOURS[i % len(COLOURS)], "linestyle": LINE_STYLES[i % len(LINE_STYLES)]}


def finish(axes: Axes, xlabel: str, ylabel: str) -> None:
    """Label the axes and give them the common look."""
    axes.set_xlabel(xlabel)
    axes.set_ylabel(ylabel)
    axes.grid(color="0.9", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def state_law(figure: Figure, law: str, title: str = "") -> None:
    """Say above a figure what it shows, and under which tether law, if texts say so."""
    lines = [title] if title else []
    if law:
        lines.append(f"tether law: {law}")
    if lines:
        figure.suptitle("\n".join(lines), color=INK, fontsize="medium")


def legend_beside(figure: Figure, axes: Axes) -> None:
    """One legend for the figure, of the curves in `axes`, to the right of them.

    Of more than `MOST_NAMED` curves the first are named, and the number of the others.
    """
    handles, labels = axes.get_legend_handles_labels()
    if (others := len(labels) - MOST_NAMED) > 0:
        handles = [*handles[:MOST_NAMED], Line2D([], [], linestyle="")]
        labels = [*labels[:MOST_NAMED], f"and {others} more"]
    figure.legend(handles, labels, loc="outside right upper", frameon=False)


def legend_below(figure: Figure, axes: Axes, columns: int) -> None:
    """One legend for the figure, of the curves in `axes`, where it covers none."""
    figure.legend(
        *axes.get_legend_handles_labels(), loc="outside lower center", ncols=columns, frameon=False
    )
