"""What experiments find, in tables, figures and pages."""

from torchbrdf.report.grid_page import write_grid_report
from torchbrdf.report.human_page import HumanPage, write_human_report
from torchbrdf.report.images_page import write_images_report
from torchbrdf.report.metric_page import write_metric_report
from torchbrdf.report.published_page import write_published_report

__all__ = [
    "HumanPage",
    "write_grid_report",
    "write_human_report",
    "write_images_report",
    "write_metric_report",
    "write_published_report",
]
