"""What all pictures share: colors, font sizes, and how a figure is finished."""

from typing import Any

DPI = 200
# Its lightness increases monotonically, so it can be read in grey print and without hue.
MAP = "viridis"
# Orange and purple can be distinguished with any color blindness; hatching is added for grey print.
DIVERGING = "PuOr"
INK, PALE, ACCENT = "#1b1b1b", "#e3e3e3", "#d1495b"
TRIAD = ("#d1495b", "#2a9d5c", "#2f6fde")
# Colors of Okabe and Ito, which color-blind readers can distinguish; without yellow, too pale for lines.
COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#7a4fb5", "#6b6b00")
STYLE = {"font.size": 9, "axes.titlesize": 9, "axes.edgecolor": "#888888", "axes.linewidth": 0.6}
# Names are escaped for matplotlib's own text; TeX could execute commands in them.
STYLE |= {"text.usetex": False}
STYLE |= {"xtick.color": "#555555", "ytick.color": "#555555", "xtick.labelsize": 8, "ytick.labelsize": 8}
STYLE |= {"grid.color": "#dddddd", "grid.linewidth": 0.6}
STYLE |= {f"axes3d.{k}axis.panecolor": (0.97, 0.97, 0.97, 0.6) for k in "xyz"}


def pyplot() -> Any:
    try:
        import matplotlib.pyplot as plt
    except ImportError as error:
        raise ImportError("pictures need matplotlib: pip install ikjax[viz]") from error
    return plt


def finish(figure, path):
    """The figure; saved and closed where a path is given."""
    if path is not None:
        figure.savefig(path, dpi=DPI)
        pyplot().close(figure)
    return figure


def file_types() -> tuple[str, ...]:
    """File extensions that `path` may have, without the dot."""
    plt = pyplot()
    canvas = plt.figure().canvas
    plt.close(canvas.figure)
    return tuple(sorted(canvas.get_supported_filetypes()))


def one_color(color: str):
    """A color map of one color."""
    from matplotlib.colors import ListedColormap

    return ListedColormap([color])
