"""Sections of docstrings as griffe, which reads them for the reference, knows them."""

import re
from typing import Any

import griffe


class Sections(griffe.Extension):
    """Renames sections in every docstring that the reference shows."""

    def on_object(self, *, obj: griffe.Object, **kwargs: Any) -> None:
        """Called for everything that was collected."""
        if obj.docstring is None:
            return
        names = {"Example": "Examples"}  # an Example is taken for a remark, Examples are code
        if isinstance(obj, griffe.Class) and any(str(base) == "NamedTuple" for base in obj.bases):
            names["Args"] = "Attributes"  # griffe sees no signature
        for old, new in names.items():
            obj.docstring.value = re.sub(rf"^( *){old}:$", rf"\1{new}:", obj.docstring.value, flags=re.MULTILINE)
