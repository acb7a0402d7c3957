"""pbrt's files, read by its grammar."""

import json
from pathlib import Path
from typing import Any

TYPES = {"string", "float", "rgb", "bool", "integer", "spectrum"}


def tokens(text: str) -> list[str]:
    """pbrt's: quoted strings with their quotes, brackets, words; a # begins a comment."""
    found, k = [], 0
    while k < len(text):
        if text[k] == "#":
            k = text.index("\n", k)
        elif text[k] == '"':
            end = k + 1
            while text[end] != '"':
                assert text[end] != "\n"
                end += 2 if text[end] == "\\" else 1
            found.append(text[k : end + 1])
            k = end + 1
        elif text[k] in "[]":
            found.append(text[k])
            k += 1
        elif text[k].isspace():
            k += 1
        else:
            end = k
            while not text[end].isspace() and text[end] not in '[]"#':
                end += 1
            found.append(text[k:end])
            k = end
    return found


def materials_of(path: Path) -> list[tuple[str, dict[str, Any]]]:
    """The names and the parameters, `{"float roughness": [0.1]}`, of a file of named materials."""
    found: list[tuple[str, dict[str, Any]]] = []
    rest = tokens(path.read_text(encoding="utf-8"))
    while rest:
        directive, name, *rest = rest
        assert directive == "MakeNamedMaterial"
        parameters: dict[str, Any] = {}
        while rest and rest[0] != directive:
            key, opening, *rest = rest
            kind, _ = json.loads(key).split(" ")
            assert kind in TYPES and opening == "["
            end = rest.index("]")
            parameters[json.loads(key)] = [json.loads(value) for value in rest[:end]]
            rest = rest[end + 1 :]
        found.append((json.loads(name), parameters))
    return found
