"""What may happen to a file: flipped bits, a lost end, exchanged arrays, wrong types, edited JSON, huge sizes."""

from __future__ import annotations

import copy
import io
import json
import random
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

__all__ = [
    "Damage",
    "damage_array_file",
    "damage_bytes",
    "damage_json",
    "damage_npz",
    "damage_png",
    "damage_safetensors",
    "damage_text",
    "edit_json",
]

Damage = Callable[[bytes, random.Random], bytes]
"""(content, source of chance) -> damaged content."""

VALUES: tuple[Any, ...] = (
    None, True, -1, 0, 7, 10**6, 2**31, 10**30, 0.5, 1e308, "", "a", "../a", "\ud800", "x" * 1000,
    [], {}, [[]], {"a": [1]},
)  # fmt: skip
"""What a value of JSON may become."""
_WORDS = (b"nan", b"inf", b"-1", b"1e999", b"999999999999", b"x", b"\x00", b"\xff\xfe", b"{", b"\n", b" ")


def damage_bytes(content: bytes, chance: random.Random) -> bytes:
    """Bits flipped, the end lost, a part doubled, lost or filled with one value."""
    start, end = sorted(chance.randrange(len(content) + 1) for _ in range(2))
    ways: tuple[Callable[[], bytes], ...] = (
        lambda: content[:start],
        lambda: content[:start] + content[start // 2 : start] + content[start:],
        lambda: content[:start] + content[end:],
        lambda: content[:start] + bytes([chance.randrange(256)]) * (end - start) + content[end:],
        lambda: content + content[start:end],
        lambda: _flip(content, chance),
        lambda: _flip(content, chance),
    )
    return chance.choice(ways)()


def _flip(content: bytes, chance: random.Random) -> bytes:
    damaged = bytearray(content)
    for _ in range(chance.randrange(1, 6)):
        damaged[chance.randrange(len(damaged))] ^= 1 << chance.randrange(8)
    return bytes(damaged)


def damage_text(content: bytes, chance: random.Random) -> bytes:
    """A word or a line of a text exchanged, doubled or lost, or its bytes damaged."""
    lines = content.split(b"\n")
    place = chance.randrange(len(lines))
    words = lines[place].split(b" ")
    how = chance.randrange(4)
    if how == 0:
        return damage_bytes(content, chance)
    if how == 1:
        lines[place : place + 1] = [lines[place]] * chance.choice([0, 2, 50])
    elif how == 2:
        words[chance.randrange(len(words))] = chance.choice(_WORDS)
        lines[place] = b" ".join(words)
    else:
        other = chance.randrange(len(lines))
        lines[place], lines[other] = lines[other], lines[place]
    return b"\n".join(lines)


def damage_json(content: bytes, chance: random.Random) -> bytes:
    """One value of a JSON text exchanged or gone, or its bytes damaged."""
    if chance.random() < 0.3:
        return damage_bytes(content, chance)
    return json.dumps(edit_json(json.loads(content), chance)).encode()


def edit_json(value: Any, chance: random.Random) -> Any:
    """A copy with one value exchanged for another one, gone, or put in twice."""
    value = copy.deepcopy(value)
    paths = [path for path in _places(value) if path]
    if not paths:
        return chance.choice(VALUES)
    path = chance.choice(paths)
    parent = value
    for key in path[:-1]:
        parent = parent[key]
    if chance.random() < 0.25:
        del parent[path[-1]]
    elif isinstance(parent, list) and chance.random() < 0.2:
        parent.append(parent[path[-1]])
    else:
        parent[path[-1]] = chance.choice(VALUES)
    return value


def _places(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Paths of all values in JSON."""
    yield path
    children: Any = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, child in children:
        yield from _places(child, (*path, key))


def damage_array(array: np.ndarray, chance: random.Random) -> np.ndarray:
    """An array of another shape, type, byte order or content."""
    ways: tuple[Callable[[], Any], ...] = (
        lambda: array[..., None],
        lambda: array.reshape(-1)[:1],
        lambda: array[:-1] if array.ndim else array,
        lambda: array.T,
        lambda: array[::-1] if array.ndim else array,
        lambda: np.empty(0),
        lambda: np.empty((0, *array.shape[1:]), array.dtype),
        lambda: np.array(3.5),
        lambda: np.array("text"),
        lambda: array.astype(complex),
        lambda: array.astype(str),
        lambda: array.astype(np.float16),
        lambda: array.astype(array.dtype.newbyteorder()),
        lambda: np.zeros(array.shape, "datetime64[s]"),
        lambda: np.zeros(array.shape, [("a", "f4"), ("b", "i4")]),
        lambda: np.array([{"a": 1}, None], object),
        lambda: np.full(array.shape, np.nan),
        lambda: np.full(array.shape, np.inf, np.float32),
        lambda: np.full(array.shape, 1e30),
        lambda: np.zeros_like(array),
        lambda: -np.ones_like(array, dtype=np.int64) * 2**62,
        lambda: np.concatenate([array, array]) if array.ndim else array,
    )
    return np.asarray(chance.choice(ways)())


def damage_npz(content: bytes, chance: random.Random) -> bytes:
    """An archive's bytes, its header, or its arrays damaged: one of them, two exchanged, or one of a huge size."""
    how = chance.randrange(5)
    if how == 0:
        return damage_bytes(content, chance)
    with np.load(io.BytesIO(content)) as file:
        arrays = {name: file[name] for name in file.files}
    names = [name for name in arrays if name != "header"]
    if how == 1 and "header" in arrays:
        arrays["header"] = np.array(_edited(str(arrays["header"]), chance))
    elif how == 2:
        one, other = chance.choice(names), chance.choice(names)
        arrays[one], arrays[other] = arrays[other], arrays[one]
    elif how == 3:
        return _with_huge_array(arrays, chance.choice(names))
    elif chance.random() < 0.2:
        del arrays[chance.choice(names)]
    else:
        name = chance.choice(names)
        arrays[name] = damage_array(arrays[name], chance)
    out = io.BytesIO()
    np.savez(out, **arrays)
    return out.getvalue()


def _edited(header: str, chance: random.Random) -> str:
    text = json.dumps(edit_json(json.loads(header), chance))
    return damage_bytes(text.encode(), chance).decode("utf-8", "replace") if chance.random() < 0.3 else text


def _with_huge_array(arrays: dict[str, np.ndarray], name: str) -> bytes:
    """An archive in which one array's header tells a size of terabytes."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        for key, array in arrays.items():
            archive.writestr(f"{key}.npy", _huge() if key == name else _npy(array))
    return out.getvalue()


def _npy(array: np.ndarray) -> bytes:
    out = io.BytesIO()
    np.save(out, array)
    return out.getvalue()


def _huge() -> bytes:
    out = io.BytesIO()
    np.lib.format.write_array_header_1_0(out, {"descr": "<f8", "fortran_order": False, "shape": (10**6, 10**6)})
    return out.getvalue() + bytes(64)


def damage_array_file(content: bytes, chance: random.Random) -> bytes:
    """A single ``.npy`` file's bytes, shape, type or content damaged."""
    how = chance.randrange(3)
    if how == 0:
        return damage_bytes(content, chance)
    return _huge() if how == 1 else _npy(damage_array(np.load(io.BytesIO(content)), chance))


def damage_safetensors(content: bytes, chance: random.Random) -> bytes:
    """Weights' bytes, header or values damaged."""
    how = chance.randrange(4)
    size = struct.unpack("<Q", content[:8])[0]
    header, data = json.loads(content[8 : 8 + size]), content[8 + size :]
    if how == 0:
        return damage_bytes(content, chance)
    if how == 1:  # a header that tells another length
        return struct.pack("<Q", chance.choice([0, 1, size - 1, size + 1, 2**40, 2**63])) + content[8:]
    if how == 2:
        header = edit_json(header, chance)
    else:
        data = _poisoned(data, chance)
    text = json.dumps(header).encode()
    return struct.pack("<Q", len(text)) + text + data


def _poisoned(data: bytes, chance: random.Random) -> bytes:
    """One number of float32 values that is none."""
    start = 4 * chance.randrange(max(1, len(data) // 4))
    return data[:start] + struct.pack("<f", chance.choice([float("nan"), float("inf")])) + data[start + 4 :]


def damage_png(content: bytes, chance: random.Random) -> bytes:
    """A picture's bytes damaged, or its header, which then tells another size, depth or kind of colour."""
    if chance.random() < 0.5:
        return damage_bytes(content, chance)
    header = bytearray(content[16:29])  # width, height, bits, kind of colour, three methods
    place = chance.choice([0, 4])
    if chance.random() < 0.5:
        header[place : place + 4] = struct.pack(">I", chance.choice([0, 1, 100, 30_000, 2**31 - 1]))
    else:
        header[chance.choice([8, 9, 10, 12])] = chance.choice([0, 1, 2, 3, 4, 6, 8, 16, 255])
    checksum = struct.pack(">I", zlib.crc32(b"IHDR" + bytes(header)))
    return content[:16] + bytes(header) + checksum + content[33:]
