"""Forecasts as animations: what was seen, then the target and each method's forecast beside each other.

Tiles have an orange rim around what is forecast, and a purple one around what an oracle says: colours of Okabe and Ito,
on maps in grey.
"""

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from envpred.horizons import in_seconds
from envpred.pictures.grids import gif
from envpred.results.scenes import Scene

# The palette: greys from black to white, and the colours of rims.
BLACK, RIM, PALE, ORACLE_RIM, WHITE, FORECAST_RIM = 0, 148, 227, 251, 252, 254
SHADES = 36  # of a map; more make files grow and nobody sees them
HEAD, LINE, EDGE = 38, 20, 6  # pixels above all tiles, above each and between them
TARGET = "target"


def _palette() -> list[int]:
    colours = [[round(255 * grey / WHITE)] * 3 for grey in range(WHITE + 1)] + [[0, 0, 0], [230, 159, 0], [0, 0, 0]]
    colours[ORACLE_RIM] = [204, 121, 167]
    return [value for colour in colours for value in colour]


PALETTE = _palette()


def scene_animation(scene: Scene, scale: int = 2, pace: float = 0.5, across: int = 4) -> bytes:
    """A GIF that plays a window: every tile shows what was seen, then the target and each method's forecast.

    Args:
        scene: the window.
        scale: pixels a cell.
        pace: how fast it plays; 1 is real time.
        across: tiles in a row, at most.
    """
    known = len(scene.seen) or len(scene.target)
    tracks = {**({TARGET: scene.target} if known else {}), **scene.forecasts}
    height, width = next(iter(scene.forecasts.values())).shape[1:]
    tile = (width * scale, height * scale)
    across = min(across, len(tracks))
    rows = -(-len(tracks) // across)
    size = (across * (tile[0] + EDGE) + EDGE, HEAD + rows * (tile[1] + LINE + EDGE))
    font = ImageFont.load_default(13)

    def frame(t: int) -> Image.Image:
        canvas = Image.new("L", size, WHITE)
        draw = ImageDraw.Draw(canvas)
        _head(draw, scene, t, size[0], scale)
        for k, (name, grids) in enumerate(tracks.items()):
            x, y = EDGE + k % across * (tile[0] + EDGE), HEAD + k // across * (tile[1] + LINE + EDGE)
            draw.text((x, y + 1), name, BLACK, font)
            grid = scene.seen[t - 1] if t <= 0 else grids[t - 1] if t <= len(grids) else None
            y += LINE
            if grid is None:
                canvas.paste(PALE, (x, y, x + tile[0], y + tile[1]))
                draw.text((x + 8, y + 8), "no target" if name == TARGET else "not forecast", BLACK, font)
            else:
                canvas.paste(Image.fromarray(_map(grid).repeat(scale, 0).repeat(scale, 1)), (x, y))
            rim = RIM
            if t > 0 and name != TARGET:
                rim = ORACLE_RIM if name in scene.oracles else FORECAST_RIM
            draw.rectangle((x, y, x + tile[0] - 1, y + tile[1] - 1), outline=rim, width=3)
            if name in scene.oracles:
                draw.rectangle((x, y + tile[1] - 19, x + 48, y + tile[1] - 1), WHITE, ORACLE_RIM)
                draw.text((x + 5, y + tile[1] - 18), "oracle", BLACK, font)
        canvas.putpalette(PALETTE)
        return canvas

    return gif(frame, range(-len(scene.seen) + 1, scene.horizons + 1), scene.period / pace)


def _head(draw: ImageDraw.ImageDraw, scene: Scene, t: int, width: int, scale: int) -> None:
    """Where and when the frame of step `t` is, and how long ten metres are."""
    font = ImageFont.load_default(13)
    draw.text((6, 2), scene.where, BLACK, font)
    sign = "-" if t < 0 else "+"
    draw.text((6, 19), f"{sign}{in_seconds(abs(t) * scene.period)}  {'forecast' if t > 0 else 'seen'}", BLACK, font)
    metres = 10 / scene.resolution * scale  # pixels of ten metres
    draw.line((width - 6 - metres, 31, width - 6, 31), BLACK, 3)
    draw.text((width - 6 - metres, 12), "10 m", BLACK, font)


def _map(grid: NDArray[np.floating]) -> NDArray[np.uint8]:
    """Grey levels of a grid (H, W) as a map, north up: rows from north to south, columns from west to east."""
    shade = np.rint(SHADES * (1 - np.clip(grid, 0, 1))) * (WHITE // SHADES)
    return np.asarray(shade.astype(np.uint8).T[::-1])
