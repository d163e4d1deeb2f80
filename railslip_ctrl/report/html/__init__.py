"""A design report as one HTML file that needs nothing else: text, tables, and pictures embedded."""

from .page import design_report_html

__all__ = ["design_report_html"]
