"""Poses estimated from the scans alone: KISS-ICP (Vizzo et al. 2023), where nobody measured any (extra `odometry`)."""

from collections.abc import Iterable
from importlib.metadata import PackageNotFoundError, version

import numpy as np
from numpy.typing import NDArray

from envpred.errors import UserError
from envpred.mapping.deskew import deskew
from envpred.mapping.geometry import FloatArray

METHOD = "kiss-icp"
FARTHEST = 100.0  # metres: what is farther takes no part
VOXEL = 1.0  # metres: side of the map's cells, a hundredth of the range, as the authors have it


def by_whom() -> str:
    """Name and version of what estimates poses.

    Raises:
        UserError: if it is not installed.
    """
    try:
        return f"{METHOD} {version(METHOD)}"
    except PackageNotFoundError:
        raise UserError(
            f"poses are estimated by {METHOD}, which is not installed: pip install 'envpred[odometry]'"
        ) from None


def estimate(
    sweeps: Iterable[tuple[NDArray[np.float32], FloatArray | None]], period: float
) -> tuple[FloatArray, FloatArray]:
    """Poses (T, 4, 4) of the sensor in the middle of its sweeps, in the frame of the first, and when (T,) that is.

    Args:
        sweeps: points (N, >=3) of each scan in metres, and seconds (N,) from the scan's time to each point's, or None
            where the ego's motion within a sweep is to be left in.
        period: seconds between scans.

    Returns:
        The poses, and the seconds from each scan's time to the middle of its sweep.
    """
    from kiss_icp.config import load_config
    from kiss_icp.kiss_icp import KissICP

    config = load_config(None)
    config.data.max_range, config.mapping.voxel_size = FARTHEST, VOXEL
    config.data.deskew = False  # its own goes to the end of the sweep, which is not always when a scan is stamped
    odometry = KissICP(config)
    poses, middles = [], []
    for points, since in sweeps:
        straight, middle = points, 0.0
        if since is not None:
            # As if the last motion went on, and to the middle, where its error shifts nothing on average.
            middle = float(since.min() + since.max()) / 2
            motion = np.stack([np.eye(4), odometry.last_delta])
            straight = deskew(points, since, middle, middle + np.array([0.0, period]), motion)
        odometry.register_frame(straight[:, :3].astype(np.float64), np.zeros(0))
        poses.append(odometry.last_pose.copy())
        middles.append(middle)
    return np.stack(poses), np.array(middles)
