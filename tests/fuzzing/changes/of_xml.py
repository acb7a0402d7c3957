"""Changes of what XML says: elements that are missing, twice or elsewhere, document types, other encodings."""

import re
from random import Random

from fuzzing.changes import Change
from fuzzing.changes.byte import NUMBERS, WORDS, encoded

_ELEMENT = re.compile(rb"<([A-Za-z]+)[^<>]*>[^<>]*</\1>")
_BOMB = b'<!DOCTYPE x [<!ENTITY a "aaaaaaaa">%b<!ENTITY z "&a;&a;">]>' % b"".join(
    b'<!ENTITY %c "&%c;&%c;">' % (k + 1, k, k) for k in range(ord("a"), ord("y"))
)


def element(source: Random, data: bytes) -> bytes:
    """An element without others in it is missing, twice, elsewhere, or says something else."""
    places = [match.span() for match in _ELEMENT.finditer(data, 0, 1 << 20)]
    if not places:
        raise ValueError("no element")
    start, end = source.choice(places)
    other = source.choice(places)[0]
    kind = source.randrange(4)
    if kind == 0:
        return data[:start] + data[end:]
    if kind == 1:
        return data[:other] + data[start:end] + data[other:]
    if kind == 2:
        low, high = data.index(b">", start) + 1, data.rindex(b"<", start, end)
        return data[:low] + encoded(source.choice((*NUMBERS, *WORDS))) + data[high:]
    return re.sub(rb"^<[A-Za-z]+", b"<Other", data[start:end]).join((data[:start], data[end:]))


def markup(source: Random, data: bytes) -> bytes:
    """Markup in some place that is not of the file's kind."""
    new = source.choice(
        (
            _BOMB,
            b'<!DOCTYPE x SYSTEM "file:///etc/passwd">',
            b"&z;",
            b"&amp;&lt;",
            b"<![CDATA[1 2 3]]>",
            b"<!-- 1 -->",
            b"<?php 1 ?>",
            b"<a>" * 5000,
            b"<a/>" * 5000,
            b"</Layer>",
            b'<a b="1" b="2"/>',
        )
    )
    place = source.choice((data.find(b"?>") + 2, source.randrange(len(data) + 1)))
    return data[:place] + new + data[place:]


def encoding(source: Random, data: bytes) -> bytes:
    """Another encoding is declared than the bytes have, or has been used."""
    name = source.choice((b"latin-1", b"UTF-16", b"UTF-7", b"ascii", b"EBCDIC-CP-US", b"none", b"x" * 500, b""))
    declared = data.replace(b"UTF-8", name, 1)
    return declared if source.random() < 0.7 else declared.decode("utf-8", "replace").encode("utf-16")


XML: tuple[Change, ...] = (element, element, markup, encoding)
