"""Pages: `page` fills the template with a `blocks.FirstPage` and sections, which the other modules make."""
