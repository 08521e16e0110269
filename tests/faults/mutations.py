"""What happens to files: flipped bits, cuts, foreign content, edited JSON, text, arrays and archives.

A mutation is drawn from a `Random`, so that hypothesis chooses it, and makes new content of the old.
"""

import ast
import io
import json
import struct
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path
from random import Random
from typing import Any

import torch
import yaml

FOLDER = b"\0folder"  # stands for a folder in the place of the file
FOREIGN = (
    b"",
    b"\0" * 4096,
    b"hello\n",
    b"\x89PNG\r\n\x1a\n" + bytes(range(64)),
    b"PK\x03\x04" + bytes(60),
    b"PK\x05\x06" + bytes(18),
    b"\x93NUMPY\x01\x00\x46\x00" + b"{" * 70,
    b"\x80\x02cos\nsystem\nq\x00X\x04\x00\x00\x00trueq\x01\x85q\x02Rq\x03.",
    b"{}",
    b"[]",
    b"null",
    b"\xff\xfe\x00\x01",
    b"[" * 100_000,
    b'{"format": 2}',
)
HUGE = (2**63, 10**12, 10**30, -(10**12), 10**400)
NUMBERS = (0, -1, 1, 2, 3, 7, 0.5, -0.0, 1e-300, 1e300, float("nan"), float("inf"), -float("inf"), *HUGE)
TEXTS = (
    "",
    ".",
    "..",
    "/",
    "a",
    "-1",
    "NaN",
    "1e400",
    "Ω\u202e",
    "\ud800",
    "a\nb",
    "a\0b",
    "x" * 5000,
    "<f4",
    "|O",
    "O",
)
OTHERS: tuple[Any, ...] = (None, True, False, [], {}, [[]], {"a": {"b": [1]}}, [None], ["a", 1])
DTYPES = ("|O", "<f8", ">f4", "<i8", "<U4", "|V8", "|b1", "<c8", "<M8[s]", "x", "f4, (2,)i4", "<f2", "|u1")


def mutated(random: Random, name: str, content: bytes, paths: Sequence[str] = ()) -> bytes | None:
    """The `content` of the file `name` after an accident or an edit; None where it is gone.

    Args:
        random: draws what happens.
        name: its ending decides which edits know the format.
        content: as the program wrote it.
        paths: of files that do not belong to the folder, which an edit may name.
    """
    ending = Path(name).suffix
    edits: list[Callable[[], bytes]] = []
    if ending == ".json":
        edits = [lambda: edited_json(random, content, paths)] * 6
    elif ending in (".npz", ".ckpt"):
        edits = [lambda: edited_archive(random, content, paths)] * 3
        if ending == ".ckpt":
            edits += [lambda: edited_checkpoint(random, content, paths)] * 3
    elif ending == ".npy":
        edits = [lambda: edited_array(random, content)] * 2
    elif ending in (".txt", ".xml", ".yaml", ".log"):
        edits = [lambda: edited_text(random, content.decode(), paths).encode(errors="surrogatepass")] * 3
        if ending == ".yaml":
            edits += [lambda: edited_yaml(random, content, paths)] * 6
        if ending == ".log":
            edits += [lambda: edited_lines(random, content, paths)] * 6
    kind = random.randrange(len(edits) + 2)
    if kind < len(edits):
        return edits[kind]()
    return None if random.randrange(20) == 0 else damaged(random, content)


def damaged(random: Random, content: bytes) -> bytes:
    """What a disk, a network or a hand on the wrong file makes of any content."""
    size, place = len(content), random.randrange(len(content) + 1)
    block, few = random.choice((16, 512, 4096)), bytes(random.randrange(256) for _ in range(random.randrange(1, 9)))
    kinds: list[Callable[[], bytes]] = [
        lambda: _flipped(random, content),
        lambda: _flipped(random, content),
        lambda: _flipped(random, content),
        lambda: content[:place],
        lambda: content[place:],
        lambda: content[:place] + few + content[place:],
        lambda: content[:place] + b"\0" * min(block, size - place) + content[place + block :],
        lambda: content + content[:place],
        lambda: random.choice((*FOREIGN, FOLDER)),
    ]
    return random.choice(kinds)()


def _flipped(random: Random, content: bytes) -> bytes:
    changed = bytearray(content)
    for _ in range(random.choice((1, 1, 1, 2, 8)) if content else 0):
        changed[random.randrange(len(content))] ^= 1 << random.randrange(8)
    return bytes(changed)


def edited_json(random: Random, content: bytes, paths: Sequence[str] = ()) -> bytes:
    """JSON with one or two values changed by hand: other types, numbers and texts, other keys, doubled keys."""
    value = json.loads(content)
    for _ in range(random.choice((1, 1, 1, 2))):
        value = _edited(random, value, paths)
    text = json.dumps(value, indent=random.choice((None, 1)))
    if random.randrange(30) == 0:  # a key twice, the other value first or last
        first = text.find('"')
        key = text[first : text.find('"', first + 1) + 1]
        text = text.replace(key, f"{key}: {json.dumps(random.choice((*OTHERS, *NUMBERS)))}, {key}", 1)
    if random.randrange(60) == 0:
        text = text.replace("1", random.choice(("[" * 50_000, "1e999", "0" * 5000 + "1", "0x1", "١")), 1)
    return text.encode(errors="surrogatepass")


def _edited(random: Random, value: Any, paths: Sequence[str]) -> Any:
    """`value` with something in it changed; large lists are as likely as single values."""
    deeper = isinstance(value, dict | list) and len(value) > 0 and random.randrange(6) > 0
    if not deeper:
        return _another(random, value, paths)
    keys = list(value) if isinstance(value, dict) else list(range(len(value)))
    key = random.choice(keys)
    changed = value.copy()
    kind = random.randrange(8)
    if kind == 0:
        del changed[key]
    elif kind == 1 and isinstance(value, dict):
        other = random.choice((*paths, *TEXTS, *map(str, keys)))
        changed = {(other if k == key else k): v for k, v in changed.items()}
    elif kind == 1:
        changed.insert(key, value[key])
    elif kind == 2:
        changed[key] = value[random.choice(keys)]
    else:
        changed[key] = _edited(random, value[key], paths)
    return changed


def _another(random: Random, value: Any, paths: Sequence[str]) -> Any:
    kind = random.randrange(8)
    if isinstance(value, str) and paths and kind <= 2:
        return random.choice(paths)
    if isinstance(value, str) and kind == 3:
        return random.choice((value.upper(), value[:-1], value + "x", value[::-1], f" {value}", f"./{value}"))
    if isinstance(value, int | float) and not isinstance(value, bool) and kind <= 3:
        return random.choice((value + 1, value - 1, -value, value * 1000, value // 7, str(value), [value], value * 2))
    if isinstance(value, list) and kind <= 3:
        return random.choice((value[:-1], value[1:], value[::-1], value + value[:1], [value], value * 3))
    if isinstance(value, dict) and kind <= 2:
        return random.choice((list(value), list(value.values()), {"": value}, {}))
    return random.choice((*NUMBERS, *TEXTS, *OTHERS, *paths))


def edited_text(random: Random, text: str, paths: Sequence[str] = ()) -> str:
    """Text with a line or a word changed."""
    lines = text.split("\n")
    place = random.randrange(len(lines))
    kind = random.randrange(8)
    if kind == 0:
        del lines[place]
    elif kind == 1:
        lines.insert(place, lines[random.randrange(len(lines))])
    elif kind == 2:
        lines[place] = random.choice((*TEXTS, "é", "- a", "a: [", "a: *b", "!!python/object:os.system {}", "\t", "# x"))
    elif kind == 3:
        lines[place] = lines[place] * random.choice((2, 50))
    else:
        words = lines[place].split(" ")
        known = [word for line in lines for word in line.split()] or [""]
        word = random.choice((*NUMBERS, *TEXTS, *paths, "[]", "{a: b}", "null", "true", random.choice(known)))
        words[random.randrange(len(words))] = str(word) if abs(len(str(word))) < 6000 else "1e999"
        lines[place] = " ".join(words)
    return "\n".join(lines)


def edited_yaml(random: Random, content: bytes, paths: Sequence[str] = ()) -> bytes:
    """YAML with something in it changed."""
    return yaml.safe_dump(_edited(random, yaml.safe_load(content), paths), allow_unicode=True).encode(
        errors="surrogatepass"
    )


def edited_lines(random: Random, content: bytes, paths: Sequence[str] = ()) -> bytes:
    """Lines of JSON, one of them changed."""
    lines = content.splitlines()
    place = random.randrange(len(lines))
    lines[place] = json.dumps(_edited(random, json.loads(lines[place]), paths)).encode()
    return b"\n".join(lines) + b"\n"


def edited_checkpoint(random: Random, content: bytes, paths: Sequence[str] = ()) -> bytes:
    """A checkpoint of other values, keys and weights, as a program of somebody else's writes it."""
    out = io.BytesIO()
    torch.save(_edited(random, torch.load(io.BytesIO(content), weights_only=True), paths), out)
    return out.getvalue()


def edited_array(random: Random, content: bytes) -> bytes:
    """An `.npy` file with another header: shape, type, order or length."""
    size = struct.unpack("<H", content[8:10])[0]
    header, data = ast.literal_eval(content[10 : 10 + size].decode()), content[10 + size :]
    shape, kind = list(header["shape"]), random.randrange(7)
    if kind == 0:
        header["descr"] = random.choice(DTYPES)
    elif kind == 1:
        header["fortran_order"] = not header["fortran_order"]
    elif kind == 2 and shape:
        shape[random.randrange(len(shape))] = random.choice((0, -1, 1, 10**6, 10**12, 10**30))
        header["shape"] = tuple(shape)
    elif kind == 3:
        header["shape"] = random.choice(
            ((), (10**12,), tuple(shape[::-1]), (1, *shape), tuple(shape[:-1]), (10**9,) * 3)
        )
    elif kind == 4:
        header = {k: v for k, v in header.items() if k != random.choice(list(header))}
    elif kind == 5:
        data = random.choice((b"", data[: len(data) // 2], data + data, b"\xff" * len(data), b"\x7f" * len(data)))
    else:
        header["shape"] = random.choice(("x", None, 3, (1.5,), ("a",)))
    text = repr(header).ljust(size - 1)[: max(size - 1, len(repr(header)))] + "\n"
    return content[:8] + struct.pack("<H", len(text)) + text.encode() + data


def edited_archive(random: Random, content: bytes, paths: Sequence[str] = ()) -> bytes:
    """A zip archive with a member gone, renamed, doubled, exchanged, edited, damaged or larger than any memory."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        members = {entry.filename: archive.read(entry) for entry in archive.infolist()}
        stored = archive.infolist()[0].compress_type
    names = list(members)
    name, other = random.choice(names), random.choice(names)
    kind = random.randrange(8)
    if kind == 0:
        del members[name]
    elif kind == 1:
        members[random.choice((*paths, name.upper(), f"../{name}", f"/{name}", f"x{name}", "a.npy"))] = members.pop(
            name
        )
    elif kind == 2:
        members[name] = members[other]
    elif kind == 3:
        members[name] = damaged(random, members[name])
    elif kind == 4:
        members[f"{name}.more"] = b"x"
    elif name.endswith(".npy") and kind <= 6:
        members[name] = edited_array(random, members[name])
    elif name.endswith(".npy"):
        header = members[name][:10] + members[name][10:].split(b"\n", 1)[0]
        members[name] = header + b"\n" + b"\0" * 50_000_000
    else:
        members[name] = damaged(random, members[name])
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", stored, compresslevel=1) as archive:
        for member, data in members.items():
            archive.writestr(member, b"" if data == FOLDER else data)
    return out.getvalue()
