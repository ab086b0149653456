"""Hostile bytes, texts and JSON from valid ones, and texts made by small grammars."""

from __future__ import annotations

import base64
import io
import json
import random
import re
import zipfile
import zlib
from collections.abc import Callable
from typing import Any

NUMBERS = (
    "0",
    "-1",
    "1e999",
    "-1e999",
    "NaN",
    "Infinity",
    "9" * 30,
    "1e-320",
    "2147483648",
    "18446744073709551616",
    "0.5",
)
VALUES: tuple[Any, ...] = (
    None, True, -1, 0, 2**31, 2**63, 2**64, 1e308, float("nan"), float("inf"), "", "x", "\x1b[2J", "\u202e",
    "x" * 70_000, [], {}, [[]], [None], {"": 0}, "../../../etc/passwd", "/dev/zero", "\ud800", "9" * 5_000,
    [0] * 3, {"a": {"b": []}},
)  # fmt: skip
TEXTS = (
    "\x00",
    "\x1b]0;x\x07",
    "\u202e",
    "\u009b",
    "\x7f",
    "<img src=x onerror=alert(1)>",
    "'; --",
    "%s%n",
    "{}",
    "../",
    "\ufeff",
)
WORDS = (
    "mug", "the", "left", "of", "laptop", "behind", "between", "and", "nearest", "second", "from", "red", "not", "that",
    "is", "on", "leftmost", "in front", "which", "largest", "two", "a", "of the", "?", ",", '"', "椅子", "(", ")",
    "\x1b[31m", "-1",
)  # fmt: skip
SQL = (
    "select", "count(*)", "from records", "from labels_objects", "list(x)", "range(900000000) t(x)",
    "repeat('x', 3000000000)",
    "join records r2 on true", "read_csv('/etc/passwd')", "copy records to '/tmp/x'", "attach 'x.db'", "union all", "(",
    ")",
    "with recursive t(n) as (select 1 union all select n + 1 from t) select * from t", "order by 1", "group by verdict",
    "pragma database_list", "install httpfs", ";", "'", "where", "1 = 1", "cross join range(100000)", "*", ",",
    "limit 5",
    "getenv('HOME')", "glob('/*')", "\x00", "md5(text)", "regexp_replace(text, '(a*)*b', '')",
)  # fmt: skip


def binary(data: bytes, rng: random.Random, other: bytes = b"") -> bytes:
    """Bytes with a few changes of any kind."""
    changed = bytearray(data)
    for _ in range(rng.choice((1, 1, 1, 2, 5))):
        at, how = rng.randrange(len(changed) + 1), rng.randrange(9)
        length = min(len(changed) - at, rng.choice((1, 2, 4, 8, 64, 4096)))
        if how == 0 and at < len(changed):
            changed[at] ^= 1 << rng.randrange(8)
        elif how == 1:
            changed[at : at + length] = rng.randbytes(length)
        elif how == 2:
            del changed[at : at + length]
        elif how == 3:
            changed[at:at] = changed[at : at + length] * rng.choice((1, 3, 100))
        elif how == 4:
            del changed[at:]
        elif how == 5:
            value = rng.choice((0, 1, 2**7, 2**15, 2**31 - 1, 2**31, 2**32 - 1, 2**63 - 1, 2**64 - 1))
            width = rng.choice((1, 2, 4, 8))
            changed[at : at + width] = (value % 256**width).to_bytes(width, rng.choice(("little", "big")))
        elif how == 6:
            changed[at : at + length] = bytes(length)
        elif how == 7 and other:
            start = rng.randrange(len(other))
            changed[at:] = other[start:]
        else:
            # The beginning holds most of what is believed.
            head = rng.randrange(min(64, len(changed) + 1))
            changed[head : head + 4] = rng.randbytes(4)
    return bytes(changed)


def text(given: str, rng: random.Random) -> str:
    """A text with numbers, words or lines exchanged."""
    for _ in range(rng.choice((1, 1, 2, 4))):
        how = rng.randrange(7)
        found = list(re.finditer(r"-?\d+(\.\d+)?([eE]-?\d+)?", given))
        at = rng.randrange(len(given) + 1)
        if how <= 1 and found:
            one = rng.choice(found)
            given = given[: one.start()] + rng.choice(NUMBERS) + given[one.end() :]
        elif how == 2:
            given = given[:at] + rng.choice(TEXTS) + given[at:]
        elif how == 3:
            lines = given.split("\n")
            del lines[rng.randrange(len(lines))]
            given = "\n".join(lines)
        elif how == 4:
            lines = given.split("\n")
            lines.insert(rng.randrange(len(lines) + 1), rng.choice(lines))
            given = "\n".join(lines)
        elif how == 5:
            given = given[:at] + rng.choice(("[" * 2_000, "{" * 2_000, '"', "\n", "=", "x" * 100_000)) + given[at:]
        else:
            given = given[:at]
    return given


def value(given: Any, rng: random.Random) -> Any:
    """A JSON value of which a part, at any depth, is another, missing or twice there."""
    if isinstance(given, dict) and given and rng.random() < 0.85:
        key = rng.choice(list(given))
        changed = dict(given)
        how = rng.random()
        if how < 0.12:
            del changed[key]
        elif how < 0.2:
            changed[rng.choice(("", "x", "__class__", key + " "))] = changed[key]
        else:
            changed[key] = value(given[key], rng)
        return changed
    if isinstance(given, list) and given and rng.random() < 0.85:
        changed, at, how = list(given), rng.randrange(len(given)), rng.random()
        if how < 0.1:
            del changed[at]
        elif how < 0.2:
            changed.insert(at, changed[at])
        else:
            changed[at] = value(given[at], rng)
        return changed
    return rng.choice(VALUES)


def as_json(given: str, rng: random.Random) -> str:
    """A JSON text, or one a line, with another value in it."""
    try:
        return json.dumps(value(json.loads(given), rng), ensure_ascii=rng.random() < 0.5)
    except ValueError:
        lines = given.splitlines() or [""]
        at = rng.randrange(len(lines))
        try:
            lines[at] = json.dumps(value(json.loads(lines[at]), rng))
        except ValueError:
            return text(given, rng)
        return "\n".join(lines)


def archive(data: bytes, rng: random.Random) -> bytes:
    """A ZIP (also NPZ) of which a member is harmed, renamed, doubled or huge."""
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as old, zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as new:
        chosen = rng.choice(old.namelist())
        for name in old.namelist():
            content, how = old.read(name), rng.randrange(7)
            if name != chosen:
                how = -1
            if how == 0:
                name = rng.choice(("../../escaped", "/tmp/escaped", "x\\..\\y", "a/" * 300 + "b", name + "\x00"))
            elif how == 1:
                new.writestr(name, content)
            elif how == 2:
                content = bytes(50_000_000)
            elif how == 3:
                continue
            elif how >= 4:
                content = binary(content, rng)
            new.writestr(name, content)
    return out.getvalue()


def mutated(name: str, data: bytes, rng: random.Random, other: bytes = b"") -> bytes:
    """The content of a file in another form, by what it is and by chance."""
    if rng.random() < 0.03:
        return b""
    if data[:2] == b"PK" and rng.random() < 0.6:
        return archive(data, rng)
    try:
        plain = data.decode("utf-8")
    except UnicodeDecodeError:
        return binary(data, rng, other)
    if name.endswith((".json", ".jsonl")) and rng.random() < 0.7:
        return as_json(plain, rng).encode("utf-8", "surrogatepass")
    return text(plain, rng).encode("utf-8", "surrogatepass") if rng.random() < 0.8 else binary(data, rng, other)


def view_string(content: str, rng: random.Random) -> str:
    """A view of the page, as its string, with something in it that is not as it is written."""
    if rng.random() < 0.3:
        packed = base64.urlsafe_b64encode(zlib.compress(content.encode())).decode()
        return text(f"sv1:{packed}", rng)
    made = zlib.compress(as_json(content, rng).encode("utf-8", "surrogatepass"))
    return "sv1:" + base64.urlsafe_b64encode(made).decode().rstrip("=")


def sentence(given: str, rng: random.Random) -> str:
    if rng.random() < 0.5:
        # One word of a sentence that is understood is another.
        words = given.split()
        words[rng.randrange(len(words))] = rng.choice(WORDS)
        return " ".join(words)
    return " ".join(rng.choice(WORDS) for _ in range(rng.choice((1, 3, 5, 8, 12, 400))))


COLUMNS = ("*", "count(*)", "list(text)", "md5(text)", "repeat(text, 3000000)", "getenv('HOME')", "hash(text)", "text")
TABLES = (
    "records", "labels_objects", "(select text from records)", "range(900000000) t(text)", "read_csv('/etc/passwd')",
    "records a cross join records b cross join records c cross join range(1000000)", "glob('/*')", "duckdb_settings()",
)  # fmt: skip
TAILS = (
    "",
    "limit 5",
    "order by 1",
    "group by all",
    "where regexp_matches(text, '(a*)*b')",
    "where text < '\x7f'",
    ";;",
)


def query(given: str, rng: random.Random) -> str:
    if rng.random() < 0.6:
        return f"select {rng.choice(COLUMNS)} from {rng.choice(TABLES)} {rng.choice(TAILS)}"
    words = ["select", *(rng.choice(SQL) for _ in range(rng.randint(1, 6)))]
    return " ".join(words)


GRAMMARS: dict[str, Callable[[str, random.Random], str]] = {"sentence": sentence, "query": query, "view": view_string}
