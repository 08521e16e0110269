"""How far ahead: the time between frames, the horizons that are shown one by one, and their names."""

PERIOD = 0.1  # seconds between frames
# The horizons that the paper's table names, as steps of 0.1 s: pictures and logs show them one by one.
SHOWN_HORIZONS = (1, 5, 10, 15)


def horizon_name(steps: int) -> str:
    """A horizon of so many frames, as charts and logs name it: 5 -> 0.5s."""
    return f"{steps * PERIOD:.1f}s"
