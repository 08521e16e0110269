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
from envpred.horizons import horizon_name, in_seconds, shown_steps
from envpred.live.replay import Step
from envpred.live.stream import Stream
from envpred.mapping.dogma import moving_velocity
from envpred.mapping.evidence import pignistic
from envpred.mapping.geometry import Body, FloatArray
from envpred.mapping.mapper import Mapped
from envpred.store.files import replaced

TIMELINE = "scan_time"
SENSOR = "world/sensor"
EVERY = {"obstacles": 2, "ground": 8}  # of the points, one of so many is recorded
GREEN, GREY, VERMILION = (0, 158, 115), (170, 170, 170), (213, 94, 0)  # seen on black, grey and white alike
SKY, ORANGE = (86, 180, 233), (230, 159, 0)


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
        out.send_recording_name(drive.name)
        out.send_blueprint(_views(rr, stream))
        out.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        out.log(f"{SENSOR}/ego", _ego(rr, stream.mapper.body, stream.mapper.sensor_height), static=True)
        recorder = _Recorder(rr, out, stream, drive.tracklets())
        try:
            yield recorder.add
        finally:
            out.flush()
            out.disconnect()


def _ego(rr: Any, body: Body, height: float) -> Any:
    """The ego vehicle's body as a box from the road up to the sensor."""
    middle, size = (body.rear + body.front) / 2, (body.front - body.rear, 2 * body.half_width, height)
    return rr.Boxes3D(centers=[(middle, 0, -height / 2)], sizes=[size], colors=[ORANGE])


def _views(rr: Any, stream: Stream) -> Any:
    """What the viewer shows at first: the present from behind the ego, beside it every forecast from above.

    Grids lie at one height, so those of other times have views of their own.  All move with the sensor.
    """
    shown, view, eye = rr.blueprint, rr.blueprint.Spatial3DView, rr.blueprint.EyeControls3D
    side = stream.mapper.grid.cells * stream.mapper.grid.resolution
    behind = eye(position=(-0.65 * side, 0, 0.5 * side), look_target=(0.1 * side, 0, 0), eye_up=(0, 0, 1))
    above = eye(position=(0, 0, 1.6 * side), look_target=(0, 0, 0), eye_up=(1, 0, 0))
    contents = ["world/grid", "world/velocities", f"{SENSOR}/**"]
    now = view(name="now", origin=SENSOR, contents=contents, eye_controls=behind)
    ahead = []
    for n in shown_steps(stream.horizons, stream.period):
        contents = [_place(n, stream.period), f"{SENSOR}/ego"]
        name = f"in {in_seconds(n * stream.period)}"
        ahead.append(view(name=name, origin=SENSOR, contents=contents, eye_controls=above))
    return shown.Blueprint(
        shown.Horizontal(now, shown.Grid(*ahead), column_shares=[3, 2]), shown.SelectionPanel(state="collapsed")
    )


def _place(n: int, period: float) -> str:
    """Where the forecast of `n` steps is recorded."""
    return f"world/forecast/{horizon_name(n, period)}"


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
        self.out.log(SENSOR, rr.Transform3D(translation=sensor[:3, 3], mat3x3=sensor[:3, :3]))
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
            self._grid(_place(n, period), step.forecast.probability[n - 1], step.forecast.origin[n - 1], height)

    def _points(self, points: NDArray[np.float32], obstacle: NDArray[np.bool_]) -> None:
        for name, chosen, colour in (
            ("obstacles", points[obstacle], GREEN),
            ("ground", points[~obstacle], GREY),
        ):
            places = chosen[:: EVERY[name], :3]
            self.out.log(f"{SENSOR}/{name}", self.rr.Points3D(places, colors=[colour], radii=[0.04]))

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
        arrows = self.rr.Arrows3D(origins=starts, vectors=ways, colors=[VERMILION], radii=[0.04])
        self.out.log("world/velocities", arrows)

    def _boxes(self, frame: int) -> None:
        found = [(box, box.poses[frame - box.first]) for box in self.tracklets if frame in box.frames]
        if not found:
            self.out.log(f"{SENSOR}/boxes", self.rr.Clear(recursive=False))
            return
        turns = [pose[3] / 2 for _, pose in found]
        shape = self.rr.Boxes3D(
            centers=[(x, y, z + box.size[2] / 2) for box, (x, y, z, _) in found],
            sizes=[box.size for box, _ in found],
            quaternions=[self.rr.Quaternion(xyzw=[0, 0, np.sin(half), np.cos(half)]) for half in turns],
            labels=[box.kind for box, _ in found],
            colors=[SKY],
        )
        self.out.log(f"{SENSOR}/boxes", shape)
