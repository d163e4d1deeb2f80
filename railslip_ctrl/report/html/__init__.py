"""Pages: `page` fills the template with a first page and sections; `first_page` and `design_sections` are a report's."""

from .design_sections import design_sections
from .first_page import first_page
from .page import page

__all__ = ["design_sections", "first_page", "page"]
