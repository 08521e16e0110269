"""Recordings as somebody else reads them: with a decoder that shares nothing with what wrote them."""

from pathlib import Path
from typing import Any, NamedTuple

from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory


class Message(NamedTuple):
    """A message of a recording."""

    kind: str
    time: float
    content: Any


def messages_in(file: Path) -> dict[str, list[Message]]:
    """All messages by topic, each checked against the file's own index and checksums."""
    found: dict[str, list[Message]] = {}
    with file.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for schema, channel, message, content in reader.iter_decoded_messages():
            assert schema is not None
            assert (schema.encoding, channel.message_encoding) == ("ros2msg", "cdr")
            found.setdefault(channel.topic, []).append(Message(schema.name, message.log_time / 1e9, content))
    return found


def seconds(stamp: Any) -> float:
    """The time of a header."""
    return float(stamp.sec + 1e-9 * stamp.nanosec)
