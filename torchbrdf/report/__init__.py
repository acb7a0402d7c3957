"""What experiments find, in tables, figures and pages."""

from typing import TYPE_CHECKING

from torchbrdf._lazy import exports

if TYPE_CHECKING:
    from torchbrdf.report.grid_page import write_grid_report
    from torchbrdf.report.human_page import HumanPage, write_human_report
    from torchbrdf.report.images_page import write_images_report
    from torchbrdf.report.metric_page import write_metric_report
    from torchbrdf.report.published_page import write_published_report
    from torchbrdf.report.texels_page import write_texels_report

_HOME = {
    "write_grid_report": "grid_page",
    "HumanPage": "human_page",
    "write_human_report": "human_page",
    "write_images_report": "images_page",
    "write_metric_report": "metric_page",
    "write_published_report": "published_page",
    "write_texels_report": "texels_page",
}
__all__ = [
    "HumanPage",
    "write_grid_report",
    "write_human_report",
    "write_images_report",
    "write_metric_report",
    "write_published_report",
    "write_texels_report",
]

__getattr__, __dir__ = exports(__name__, _HOME)
