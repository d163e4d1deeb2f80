"""`python -m railslip_ctrl` is the `railslip` command."""

from .cli import main

main()
