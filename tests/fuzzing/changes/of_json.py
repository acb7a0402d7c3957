"""Changes of what a JSON file says: values of other types, keys that are gone, doubled or odd, numbers out of range."""

import copy
import json
from collections.abc import Iterator
from random import Random
from typing import Any

from fuzzing.changes import Change
from fuzzing.changes.byte import NUMBERS, WORDS, encoded

# What json cannot write is put in as text; no other text of a file begins so.
_RAW = "\ue000raw"
RAW = (
    "[" * 100_000 + "]" * 100_000, '{"a":' * 100_000 + "1" + "}" * 100_000, "[" * 900 + "]" * 900, "[" * 100_000,
    "9" * 5000, "-" + "9" * 400, "1" + "0" * 23, str(2**63), str(2**64), "-1", "0", "1", "0.5", "1e308", "-1e308",
    "1e999", "1e-300", "1e-45", "NaN", "Infinity", "-Infinity", "1.0", "1e2", "-0", "007", "[1,]", "'x'", "undefined",
    '"\\ud800"', '"a\\u0000b"', '"a\\nb"',
)  # fmt: skip
VALUES: tuple[Any, ...] = (
    None, True, False, [], {}, [[]], [None], {"": None}, [1, 2, 3], ["a"], {"a": 1}, "", [[[[1]]]], [0] * 5000,
)  # fmt: skip


def value(source: Random, data: bytes) -> bytes:
    """A value is another, of any type."""
    found = parsed(data)
    new = source.choice((source.choice(VALUES), f"{_RAW}{source.choice(RAW)}", source.choice(WORDS), _odd_text(source)))
    if source.random() < 0.03:
        return dumped(source, new)
    holder, key = source.choice(_places(source, found))
    holder[key] = new
    return dumped(source, found)


def number(source: Random, data: bytes) -> bytes:
    """A number is another."""
    found = parsed(data)
    places = [place for place in _walk(found) if type(place[0][place[1]]) in (int, float)]
    if not places:
        raise ValueError("no number")
    holder, key = source.choice(places)
    old = holder[key]
    new = (-old, old * 1e6, old + 0.5, int(old), float(old), str(old), [old], True)
    holder[key] = source.choice((source.choice(new), f"{_RAW}{source.choice(RAW)}"))
    return dumped(source, found)


def text(source: Random, data: bytes) -> bytes:
    """A text is another."""
    found = parsed(data)
    places = [place for place in _walk(found) if isinstance(place[0][place[1]], str)]
    if not places:
        raise ValueError("no text")
    holder, key = source.choice(places)
    holder[key] = source.choice(WORDS)
    return dumped(source, found)


def key(source: Random, data: bytes) -> bytes:
    """A key is gone, called otherwise, comes twice, or is new."""
    found = parsed(data)
    objects = _filled(found, dict)
    if not objects:
        raise ValueError("no object")
    holder = source.choice(objects)
    name = source.choice(list(holder))
    kind = source.randrange(4)
    if kind == 0:
        del holder[name]
    elif kind == 1:
        new = source.choice((*WORDS, *holder))
        items = [(new if one == name else one, what) for one, what in holder.items()]
        holder.clear()
        holder.update(items)
    elif kind == 2:
        holder[f"{_RAW}{json.dumps(name)}"] = source.choice((holder[name], None, "x", 3))
    else:
        holder[source.choice(WORDS)] = source.choice((*VALUES, f"{_RAW}{source.choice(RAW)}"))
    return dumped(source, found)


def items(source: Random, data: bytes) -> bytes:
    """A list is shorter, longer, empty, in another order, or holds something twice."""
    found = parsed(data)
    lists = _filled(found, list)
    if not lists:
        raise ValueError("no list")
    chosen = source.choice(lists)
    kind = source.randrange(5)
    if kind == 0:
        del chosen[source.randrange(len(chosen)) :]
    elif kind == 1:
        chosen.append(copy.deepcopy(source.choice(chosen)))
    elif kind == 2:
        chosen.pop(source.randrange(len(chosen)))
    elif kind == 3:
        source.shuffle(chosen)
    else:
        chosen[:] = chosen * 20
    return dumped(source, found)


JSON: tuple[Change, ...] = (value, value, number, number, text, text, key, key, items)


def parsed(data: bytes) -> Any:
    """What a file says; a ValueError if it is no JSON any more."""
    try:
        return json.loads(data)
    except RecursionError:
        raise ValueError("too deep") from None


def dumped(source: Random, found: Any) -> bytes:
    """As a file, with what json cannot write."""
    written = json.dumps(found, ensure_ascii=source.random() < 0.7)
    start = written.find(f'"{json.dumps(_RAW)[1:-1]}'), written.find(f'"{_RAW}')
    while max(start) >= 0:
        begin = max(start)
        raw, end = json.JSONDecoder().raw_decode(written, begin)
        written = written[:begin] + raw.removeprefix(_RAW) + written[end:]
        start = written.find(f'"{json.dumps(_RAW)[1:-1]}'), written.find(f'"{_RAW}')
    return encoded(written)


def _odd_text(source: Random) -> str:
    return source.choice(NUMBERS)


def _filled(found: Any, kind: type) -> list[Any]:
    """All objects, or lists, in a value that hold something."""
    return [one for one in [found, *(holder[key] for holder, key in _walk(found))] if isinstance(one, kind) and one]


def _walk(found: Any) -> Iterator[tuple[Any, Any]]:
    """Every value, as what holds it and its key there; no deeper than anybody writes."""
    waiting = [(found, 0)]
    while waiting:
        holder, depth = waiting.pop()
        keys = list(holder) if isinstance(holder, dict) else range(len(holder)) if isinstance(holder, list) else ()
        for one in keys:
            yield holder, one
            if depth < 30:
                waiting.append((holder[one], depth + 1))


def _places(source: Random, found: Any) -> list[tuple[Any, Any]]:
    """Values to choose from: half of the time only those near the top, of which there are few."""
    every = list(_walk(found))
    if not every:
        raise ValueError("no value")
    near = [(holder, key) for holder, key in every if isinstance(holder, dict)]
    return near if near and source.random() < 0.5 else every
