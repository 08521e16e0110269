"""A replay as a recording for Rerun's viewer: points, grid, forecasts, velocities and boxes on one timeline.

Extra `viewer`.  Grids are maps in the world, with the colours and the values of ROS's `nav_msgs/OccupancyGrid`.
"""

import importlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from envpred.drives import Drive
from envpred.drives.tracklets import Tracklet
from envpred.errors import UserError
from envpred.horizons import horizon_name, shown_steps
from envpred.live.replay import Step
from envpred.live.stream import Stream
from envpred.mapping.dogma import moving_velocity
from envpred.mapping.evidence import pignistic
from envpred.mapping.geometry import FloatArray
from envpred.mapping.mapper import Mapped
from envpred.store.files import replaced

TIMELINE = "scan_time"
EVERY = {"obstacles": 2, "ground": 8}  # of the points, one of so many is recorded
BLACK, GREY, VERMILION, SKY = (0, 0, 0), (170, 170, 170), (213, 94, 0), (86, 180, 233)


def check_installed() -> None:
    """Refuse to record where Rerun is missing.

    Raises:
        UserError: naming the extra.
    """
    _rerun()


def _rerun() -> Any:
    try:
        return importlib.import_module("rerun")
    except ImportError:
        raise UserError("a recording (.rrd) needs Rerun: pip install 'envpred[viewer]'") from None


@contextmanager
def recording(file: Path, stream: Stream, drive: Drive) -> Iterator[Callable[[Step], None]]:
    """What records the scans of a replay into `file`, whole or not at all.

    Args:
        file: to write (.rrd).
        stream: that is replayed.
        drive: that is replayed; its boxes of tracked objects, if there are any, are recorded too.
    """
    rr = _rerun()
    file.parent.mkdir(parents=True, exist_ok=True)
    with replaced(file) as part:
        out = rr.RecordingStream("envpred", recording_id=drive.name, send_properties=False)
        out.set_log_time_enabled(False)  # the scans' own time alone
        out.set_log_tick_enabled(False)
        out.save(part)
        out.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        recorder = _Recorder(rr, out, stream, drive.tracklets())
        try:
            yield recorder.add
        finally:
            out.flush()
            out.disconnect()


class _Recorder:
    """Writes one scan after the other."""

    def __init__(self, rr: Any, out: Any, stream: Stream, tracklets: Sequence[Tracklet]) -> None:
        self.rr, self.out, self.stream, self.tracklets = rr, out, stream, tracklets

    def add(self, step: Step) -> None:
        """What a scan came to; of a scan that was left out, nothing."""
        if step.mapped is None:
            return
        rr, mapped, grid = self.rr, step.mapped, self.stream.mapper.grid
        origin = self.stream.mapper.origin
        assert origin is not None
        corner = origin + grid.resolution * (mapped.centre_cell - grid.half - 0.5)
        self.out.set_time(TIMELINE, duration=mapped.time)
        sensor = mapped.pose @ self.stream.mapper.sensor_to_body
        self.out.log("world/sensor", rr.Transform3D(translation=sensor[:3, 3], mat3x3=sensor[:3, :3]))
        self._points(step.points, mapped.obstacle)
        height = float(sensor[2, 3]) - self.stream.mapper.sensor_height
        self._grid("world/grid", pignistic(mapped.mass), corner, height)
        self._velocities(mapped, corner, height)
        self._boxes(step.frame)
        if step.forecast is None:
            self.out.log("world/forecast", rr.Clear(recursive=True))  # the viewer would go on showing the last one
            return
        period = self.stream.period
        for n in shown_steps(len(step.forecast.stamp), period):
            place = f"world/forecast/{horizon_name(n, period)}"
            self._grid(place, step.forecast.probability[n - 1], step.forecast.origin[n - 1], height)

    def _points(self, points: NDArray[np.float32], obstacle: NDArray[np.bool_]) -> None:
        for name, chosen, colour in (
            ("obstacles", points[obstacle], BLACK),
            ("ground", points[~obstacle], GREY),
        ):
            places = chosen[:: EVERY[name], :3]
            self.out.log(f"world/sensor/{name}", self.rr.Points3D(places, colors=[colour], radii=[0.04]))

    def _grid(self, entity: str, probability: NDArray[np.floating], corner: FloatArray, height: float) -> None:
        """A grid (H, W) of probabilities as a map whose south-west corner lies at `corner`."""
        percent = np.rint(100 * np.clip(probability, 0, 1)).astype(np.uint8)
        n, rr = len(percent), self.rr
        image = rr.components.ImageFormat(width=n, height=n, color_model="L", channel_datatype="U8")
        rows = np.ascontiguousarray(percent.T[::-1])  # of a picture, north first
        options = {"colormap": rr.components.Colormap.RvizMap, "cell_size": self.stream.mapper.grid.resolution}
        place = [*corner.tolist(), height]
        self.out.log(entity, rr.GridMap(data=rows.tobytes(), format=image, translation=place, **options))

    def _velocities(self, mapped: Mapped, corner: FloatArray, height: float) -> None:
        """Where the moving cells will be in a second."""
        if mapped.velocities is None:
            return
        velocity, covariance = (
            torch.from_numpy(values) for values in (mapped.velocities.velocity, mapped.velocities.covariance)
        )
        moving = moving_velocity(velocity, covariance).numpy()
        cells = np.argwhere(moving.any(axis=0))
        middle = corner + self.stream.mapper.grid.resolution * (cells + 0.5)
        starts = np.column_stack([middle, np.full(len(cells), height)])
        ways = np.column_stack([moving[:, cells[:, 0], cells[:, 1]].T, np.zeros(len(cells))])
        self.out.log("world/velocities", self.rr.Arrows3D(origins=starts, vectors=ways, colors=[VERMILION]))

    def _boxes(self, frame: int) -> None:
        found = [(box, box.poses[frame - box.first]) for box in self.tracklets if frame in box.frames]
        if not found:
            self.out.log("world/sensor/boxes", self.rr.Clear(recursive=False))
            return
        turns = [pose[3] / 2 for _, pose in found]
        shape = self.rr.Boxes3D(
            centers=[(x, y, z + box.size[2] / 2) for box, (x, y, z, _) in found],
            sizes=[box.size for box, _ in found],
            quaternions=[self.rr.Quaternion(xyzw=[0, 0, np.sin(half), np.cos(half)]) for half in turns],
            labels=[box.kind for box, _ in found],
            colors=[SKY],
        )
        self.out.log("world/sensor/boxes", shape)
