"""MCAP recordings of ROS 2 messages, without ROS: container by `mcap`, types and encoding (CDR) by `rosbags`."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import yaml

from envpred import __version__
from envpred.errors import UserError
from envpred.store.files import replaced

ENDING = ".mcap"
_FOREVER = {"sec": 9223372036, "nsec": 854775807}  # what rmw takes for no limit


class Recording:
    """An MCAP file that is being written; `write_recording` opens one.

    Args:
        stream: what is written to, binary.

    Attributes:
        types: the class of a ROS 2 message by its name, such as `nav_msgs/msg/OccupancyGrid`.
    """

    def __init__(self, stream: Any) -> None:
        from mcap.writer import Writer
        from rosbags.typesys import Stores, get_typestore

        self._store = get_typestore(Stores.ROS2_HUMBLE)  # the oldest that is maintained; later ones have the same types
        self.types: Any = self._store.types
        self._writer: Any = Writer(stream)  # some of it is untyped
        self._writer.start(profile="ros2", library=f"envpred {__version__}")
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}

    def write(self, topic: str, message: Any, time: float, latched: bool = False) -> None:
        """Add a message.

        Args:
            topic: that it is published on.
            message: of one of the `types`.
            time: when, seconds.
            latched: whether who subscribes later gets the last one, too (durability transient local).
        """
        name = message.__msgtype__
        if name not in self._schemas:
            text, _ = self._store.generate_msgdef(name, ros_version=2)
            self._schemas[name] = self._writer.register_schema(name, "ros2msg", text.encode())
        if topic not in self._channels:
            about = {"offered_qos_profiles": _qos(latched)}
            self._channels[topic] = self._writer.register_channel(topic, "cdr", self._schemas[name], about)
        stamp, data = nanoseconds(time), bytes(self._store.serialize_cdr(message, name))
        self._writer.add_message(self._channels[topic], stamp, data, stamp)

    def finish(self) -> None:
        """Write the index at the end of the file."""
        self._writer.finish()


@contextmanager
def write_recording(file: Path) -> Iterator[Recording]:
    """A recording that is there whole when the block ends well, and otherwise stays what it was.

    Raises:
        UserError: without the extra `mcap`.
    """
    check_extra()
    file.parent.mkdir(parents=True, exist_ok=True)
    with replaced(file) as part, part.open("wb") as stream:
        recording = Recording(stream)
        yield recording
        recording.finish()


def check_extra() -> None:
    """Refuse to write a recording where the extra is missing, before there is work to lose.

    Raises:
        UserError: naming it.
    """
    try:
        import mcap.writer  # noqa: F401
        import rosbags.typesys  # noqa: F401
    except ImportError as error:
        raise UserError(f"writing {ENDING} needs an extra ({error}): pip install 'envpred[mcap]'") from None


def nanoseconds(time: float) -> int:
    """Seconds as MCAP and ROS count them; drives are stamped to a microsecond, and what is less is rounding."""
    return 1000 * round(1e6 * time)


def _qos(latched: bool) -> str:
    """The quality of service that a topic is offered with, as rosbag2 keeps it beside the topic."""
    profile = {
        "history": 1,  # keep last
        "depth": 1 if latched else 10,
        "reliability": 1,  # reliable
        "durability": 1 if latched else 2,  # transient local, volatile
        "deadline": _FOREVER,
        "lifespan": _FOREVER,
        "liveliness": 1,  # automatic
        "liveliness_lease_duration": _FOREVER,
        "avoid_ros_namespace_conventions": False,
    }
    return yaml.dump([profile], Dumper=_Plain, sort_keys=False)


class _Plain(yaml.SafeDumper):
    """Without references, which not every reader of YAML follows."""

    def ignore_aliases(self, data: Any) -> bool:
        return True
