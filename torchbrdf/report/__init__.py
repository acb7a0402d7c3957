"""What a study finds, in tables, figures and a page."""

from torchbrdf.report.asked import ask_simulated, plan_of
from torchbrdf.report.gallery import Gallery
from torchbrdf.report.human_page import HumanPage, write_human_report
from torchbrdf.report.images_page import write_images_report
from torchbrdf.report.metric_page import MetricPage, write_metric_report
from torchbrdf.report.page import write_report
from torchbrdf.report.study import STANDINS, Study, gather

__all__ = [
    "STANDINS",
    "Gallery",
    "HumanPage",
    "MetricPage",
    "Study",
    "ask_simulated",
    "gather",
    "plan_of",
    "write_human_report",
    "write_images_report",
    "write_metric_report",
    "write_report",
]
