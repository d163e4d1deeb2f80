"""Settings of every command; a module of its own, as listing the commands must import nothing heavy."""

from typing import Any

HELP: dict[str, Any] = {"help_option_names": ["-h", "--help"], "max_content_width": 110}
"""`context_settings` of every command. Each has them itself: click keeps the names of the help option from the first
context a command meets, and that may be one without the program above it."""
