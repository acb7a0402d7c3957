"""Pictures inside a page."""

import base64
import io
from pathlib import Path

from PIL import Image


def png(path: Path) -> str:
    """A PNG as it is."""
    return "data:image/png;base64," + base64.b64encode(path.read_bytes()).decode()


def small(path: Path) -> str:
    """A render as WebP: all of a study's pictures in one page of a few megabytes."""
    data = io.BytesIO()
    with Image.open(path) as image:
        image.save(data, format="WEBP", quality=90)
    return "data:image/webp;base64," + base64.b64encode(data.getvalue()).decode()
