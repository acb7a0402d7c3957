"""Pages that hold all their pictures."""

import base64
import io
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined, Template
from PIL import Image


def template(name: str) -> Template:
    """A page of this folder, to be filled."""
    loader = PackageLoader("torchbrdf.report", ".")
    pages = Environment(loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True)
    return pages.get_template(name)


def png(path: Path) -> str:
    """A PNG as it is."""
    return "data:image/png;base64," + base64.b64encode(path.read_bytes()).decode()


def small(path: Path) -> str:
    """A render as WebP: all of a study's pictures in one page of a few megabytes."""
    data = io.BytesIO()
    with Image.open(path) as image:
        image.save(data, format="WEBP", quality=90)
    return "data:image/webp;base64," + base64.b64encode(data.getvalue()).decode()
