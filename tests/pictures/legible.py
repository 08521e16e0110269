"""Whether a figure can be read in print: letters of a size that journals take, and none of them cut off or covered."""

import itertools
from typing import Any, cast

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.transforms import Bbox

LEAST = 7  # points
SLACK = 2  # pixels that boxes are wider than letters


def illegible(fig: Figure) -> list[str]:
    """What is wrong with the letters of a figure: too small, beyond its edge, or over others."""
    fig.canvas.draw()
    texts = _written(fig)
    found = [f"{text.get_text()}: {text.get_fontsize()} points" for text in texts if float(text.get_fontsize()) < LEAST]
    boxes = [(text.get_text(), text.get_window_extent()) for text in texts]
    page = Bbox.from_bounds(-SLACK, -SLACK, fig.bbox.width + 2 * SLACK, fig.bbox.height + 2 * SLACK)
    for text, box in boxes:
        if not (page.contains(box.x0, box.y0) and page.contains(box.x1, box.y1)):
            found.append(f"{text}: beyond the edge")
    for (text, one), (other, two) in itertools.combinations(boxes, 2):
        if one.padded(-SLACK).overlaps(two.padded(-SLACK)):
            found.append(f"{text}: over {other}")
    return found


def _written(fig: Figure) -> list[Text]:
    """All that is written on a drawn figure."""
    hidden: set[int] = set()
    for ax in cast(list[Axes], fig.findobj(Axes)):  # insets too
        for axis in (ax.xaxis, ax.yaxis):
            ticks = axis.get_major_ticks() + axis.get_minor_ticks()
            drawn = cast(Any, axis)._update_ticks() if ax.axison else []  # those within its range
            kept = {id(label) for tick in drawn for label in (tick.label1, tick.label2)}
            hidden |= {id(label) for tick in ticks for label in (tick.label1, tick.label2)} - kept
            if not ax.axison:
                hidden.add(id(axis.label))
    found = [text for text in fig.findobj(Text) if isinstance(text, Text) and id(text) not in hidden]
    return [text for text in found if text.get_visible() and text.get_text().strip()]
