"""Pictures of grasps, films, pages, tables."""

from fungrasp.report.film import film
from fungrasp.report.page import Contact, GraspReport, Page, Quantity, write_page
from fungrasp.report.pictures import captioned, four_views, grid
from fungrasp.report.video import write_video

__all__ = [
    "Contact",
    "GraspReport",
    "Page",
    "Quantity",
    "captioned",
    "film",
    "four_views",
    "grid",
    "write_page",
    "write_video",
]
