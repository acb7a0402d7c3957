"""The zoo: models that look like measured materials, which come with the package and have names in a file's place."""

import difflib
import importlib.resources
import os
from pathlib import Path
from typing import Any

from torchbrdf.errors import DataError, shown
from torchbrdf.reading import exists, read_json

SCHEME, BETWEEN = "zoo:", ":"
LISTED = "torchbrdf info --zoo lists them"
# Of a name that is not there, how many like it are said.
_NEAR = 3


def is_zoo(path: str | os.PathLike[str]) -> bool:
    """Whether a path is a name in the zoo: it begins with `zoo:` and has no folder.

    A file that is called so is `./zoo:name` as text; a `Path` drops the point, so that it has to be absolute.

    Example:
        >>> is_zoo("zoo:nickel"), is_zoo("./zoo:nickel"), is_zoo("zoo.binary")
        (True, False, False)
    """
    path = os.fspath(path)
    return path.startswith(SCHEME) and not {"/", os.sep} & set(path)


def zoo_file() -> Path:
    """The `fits.json` of all of them.

    Example:
        >>> zoo_file().name
        'zoo.json'
    """
    return Path(str(importlib.resources.files("torchbrdf.assets") / "zoo.json"))


def zoo_names() -> list[str]:
    """The materials of the zoo: `load` takes `zoo:NAME`, and `zoo:NAME:MODEL` for another model than the first.

    Returns:
        Their names, sorted.

    Example:
        >>> from torchbrdf.lobes import zoo_names
        >>> "nickel" in zoo_names()
        True
    """
    return sorted({record["material"] for record in zoo_records()})


def zoo_record(path: str | os.PathLike[str]) -> dict[str, Any]:
    """The record that is named: `zoo:nickel`, the first of a material, or `zoo:nickel:gltf`, that of a model.

    Args:
        path: A name in the zoo.

    Returns:
        An object of a `fits.json`, as it stands in the file.

    Raises:
        DataError: There is no such material, or it has no such model.

    Example:
        >>> zoo_record("zoo:nickel:gltf")["model"]
        'gltf'
    """
    path = os.fspath(path)
    name, between, model = path.removeprefix(SCHEME).partition(BETWEEN)
    if not name:
        raise DataError(f"{path}: expected a name behind {SCHEME} such as {SCHEME}nickel, found none; {LISTED}")
    own = {record["model"]: record for record in zoo_records() if record["material"] == name}
    if not own:
        raise DataError(f"{path}: expected a material of the zoo, found none{_near(name)}; {LISTED}{_a_file(path)}")
    if between and model not in own:
        found = shown(model) if model else "none"
        raise DataError(f"{SCHEME}{name}: expected one of the models {', '.join(own)} behind it, found {found}")
    return own[model or next(iter(own))]


def zoo_records() -> list[dict[str, Any]]:
    """All objects of the file, as they stand there; each model of a material is one.

    Example:
        >>> len(zoo_records()) > len(zoo_names())
        True
    """
    records: list[dict[str, Any]] = read_json(zoo_file(), list[dict[str, Any]], "a list of fits")
    return records


def _a_file(path: str) -> str:
    """What is said where somebody may have meant a file."""
    return f"; the file of that name is ./{path}" if exists(path) else ""


def _near(name: str) -> str:
    """The names that hold one that is not there, or are like it, as the end of a message."""
    names, asked = zoo_names(), name[:100].lower()
    found = sorted((one for one in names if asked in one), key=len) or difflib.get_close_matches(asked, names, _NEAR)
    return f"; did you mean {' or '.join(found[:_NEAR])}?" if found else ""
