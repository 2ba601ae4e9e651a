"""A plan to look at: one HTML page that opens without a network."""

from pipeline.show.page import page, write_page

__all__ = ["page", "write_page"]
