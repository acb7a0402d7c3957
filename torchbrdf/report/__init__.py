"""Studies end to end: fits, pictures, tables, figures, and the page that shows them."""

from torchbrdf.report.page import write_report
from torchbrdf.report.study import Study, picture

__all__ = ["Study", "picture", "write_report"]
