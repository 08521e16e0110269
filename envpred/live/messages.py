"""What we know of a drive as ROS 2 messages: grids, scans, where the ego is, and boxes of what is around it.

Frames are named as ROS has them (REP 105): `map` is the drive's world (x east, y north, z up), `base_link` the body
that poses are of, `lidar` the sensor.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from envpred.drives.tracklets import Tracklet
from envpred.live.mcap import nanoseconds
from envpred.live.occupancy_grid import OccupancyGrid
from envpred.mapping.geometry import FloatArray, heading_of

MAP, BODY, SENSOR = "map", "base_link", "lidar"
_CODES = {4: 7, 2: 4}  # of sensor_msgs/PointField by a number's bytes: FLOAT32 and UINT16
_CUBE, _ADD, _DELETE_ALL = 1, 0, 3  # codes of visualization_msgs/Marker
# Of boxes, as the simulator names them; red, green, blue.
_COLOURS = {"Pedestrian": (0.84, 0.37, 0.0), "Cyclist": (0.0, 0.62, 0.45)}
_OTHERS = (0.34, 0.71, 0.91)


class Messages:
    """Makes messages.

    Args:
        types: the class of a message by its name, as `Recording` has them.
    """

    def __init__(self, types: Any) -> None:
        self._types = types

    def grid(self, grid: OccupancyGrid) -> Any:
        """A nav_msgs/OccupancyGrid."""
        corner = self._pose((*grid.origin, 0.0), 0.0)
        info = self._new(
            "nav_msgs", "MapMetaData", self._time(grid.load_time), grid.resolution, grid.width, grid.height, corner
        )
        return self._new("nav_msgs", "OccupancyGrid", self._header(grid.stamp, MAP), info, grid.data)

    def points(self, scan: NDArray[np.float32], time: float, truth: NDArray[np.uint32] | None = None) -> Any:
        """A sensor_msgs/PointCloud2 of a scan (N, 4).

        Args:
            scan: x, y, z and reflectance in the sensor frame.
            time: of the scan, seconds.
            truth: (N,) words of SemanticKITTI, class and instance of every point, where they are known.
        """
        columns: dict[str, NDArray[Any]] = dict(zip(("x", "y", "z", "intensity"), scan.T, strict=True))
        if truth is not None:
            columns |= {"label": (truth & 0xFFFF).astype("<u2"), "instance": (truth >> 16).astype("<u2")}
        packed = np.empty(len(scan), [(name, column.dtype) for name, column in columns.items()])
        fields, step = [], 0
        for name, column in columns.items():
            packed[name] = column
            fields.append(self._new("sensor_msgs", "PointField", name, step, _CODES[column.dtype.itemsize], 1))
            step += column.dtype.itemsize
        data = packed.view(np.uint8)
        header = self._header(time, SENSOR)
        return self._new("sensor_msgs", "PointCloud2", header, 1, len(scan), fields, False, step, len(data), data, True)

    def transform(self, pose: FloatArray, time: float, frame: str = MAP, child: str = BODY) -> Any:
        """A tf2_msgs/TFMessage of where `child` lies in `frame`, by a rigid pose (4, 4)."""
        shift = self._new("geometry_msgs", "Vector3", *(float(v) for v in pose[:3, 3]))
        moved = self._new("geometry_msgs", "Transform", shift, self._turn(pose))
        stamped = self._new("geometry_msgs", "TransformStamped", self._header(time, frame), child, moved)
        return self._new("tf2_msgs", "TFMessage", [stamped])

    def odometry(self, pose: FloatArray, velocity: FloatArray, turn_rate: float, time: float) -> Any:
        """A nav_msgs/Odometry: pose (4, 4) in the map, velocity (3,) in the body frame, turn rate; errors unknown."""
        unknown = np.zeros(36)
        place = self._new("geometry_msgs", "Point", *(float(v) for v in pose[:3, 3]))
        at = self._new("geometry_msgs", "Pose", place, self._turn(pose))
        linear = self._new("geometry_msgs", "Vector3", *(float(v) for v in velocity))
        angular = self._new("geometry_msgs", "Vector3", 0.0, 0.0, float(turn_rate))
        with_pose = self._new("geometry_msgs", "PoseWithCovariance", at, unknown)
        with_twist = self._new(
            "geometry_msgs", "TwistWithCovariance", self._new("geometry_msgs", "Twist", linear, angular), unknown
        )
        return self._new("nav_msgs", "Odometry", self._header(time, MAP), BODY, with_pose, with_twist)

    def boxes(self, tracklets: Sequence[Tracklet], frame: int, time: float) -> Any:
        """A visualization_msgs/MarkerArray of the tracklets that are there in a frame, in the sensor frame.

        A marker's namespace is what it is, its number the tracklet's.  The array begins by deleting those before it.
        """
        markers = [self._marker("", 0, _DELETE_ALL, time)]
        for number, tracklet in enumerate(tracklets):
            k = frame - tracklet.first
            if 0 <= k < len(tracklet.poses):
                x, y, z, yaw = tracklet.poses[k]
                length, width, height = tracklet.size
                pose = self._pose((x, y, z + height / 2), yaw)  # of the middle; a tracklet's is of the base
                colour = _COLOURS.get(tracklet.kind, _OTHERS)
                markers.append(
                    self._marker(tracklet.kind, number, _ADD, time, pose, (length, width, height), (*colour, 0.6))
                )
        return self._new("visualization_msgs", "MarkerArray", markers)

    def _marker(
        self,
        name: str,
        number: int,
        action: int,
        time: float,
        pose: Any = None,
        size: Sequence[float] = (0.0, 0.0, 0.0),
        colour: Sequence[float] = (0.0, 0.0, 0.0, 0.0),
    ) -> Any:
        return self._new(
            "visualization_msgs",
            "Marker",
            self._header(time, SENSOR),
            name,
            number,
            _CUBE,
            action,
            pose or self._pose((0.0, 0.0, 0.0), 0.0),
            self._new("geometry_msgs", "Vector3", *size),
            self._new("std_msgs", "ColorRGBA", *colour),
            self._new("builtin_interfaces", "Duration", 0, 0),
            False,  # not locked to its frame
            [],
            [],
            "",
            self._new("sensor_msgs", "CompressedImage", self._header(0, ""), "", np.zeros(0, np.uint8)),
            [],
            "",
            "",
            self._new("visualization_msgs", "MeshFile", "", np.zeros(0, np.uint8)),
            False,
        )

    def _new(self, package: str, name: str, *fields: Any) -> Any:
        return self._types[f"{package}/msg/{name}"](*fields)

    def _time(self, time: float) -> Any:
        seconds, rest = divmod(nanoseconds(time), 1_000_000_000)
        return self._new("builtin_interfaces", "Time", seconds, rest)

    def _header(self, time: float, frame: str) -> Any:
        return self._new("std_msgs", "Header", self._time(time), frame)

    def _pose(self, place: Sequence[float], yaw: float) -> Any:
        turn = self._new("geometry_msgs", "Quaternion", 0.0, 0.0, float(np.sin(yaw / 2)), float(np.cos(yaw / 2)))
        return self._new("geometry_msgs", "Pose", self._new("geometry_msgs", "Point", *place), turn)

    def _turn(self, pose: FloatArray) -> Any:
        """The quaternion of a rigid pose."""
        from scipy.spatial.transform import Rotation

        return self._new("geometry_msgs", "Quaternion", *Rotation.from_matrix(pose[:3, :3]).as_quat().tolist())


def motion(poses: FloatArray, times: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Velocities (T, 3) in the body frame, m/s, and turn rates (T,), rad/s, of `poses` (T, 4, 4), by differences."""
    if len(poses) < 2:
        return np.zeros((len(poses), 3)), np.zeros(len(poses))
    velocity = np.gradient(poses[:, :3, 3], times, axis=0)
    return np.einsum("tji,tj->ti", poses[:, :3, :3], velocity), np.gradient(np.unwrap(heading_of(poses)), times)
