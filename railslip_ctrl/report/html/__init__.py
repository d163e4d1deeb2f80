"""A design report as one HTML file that needs nothing else: text, tables, and pictures embedded."""

from .page import Provenance, design_report_html

__all__ = ["Provenance", "design_report_html"]
