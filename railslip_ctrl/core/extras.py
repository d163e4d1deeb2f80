"""Packages that one command needs and `pip install .` leaves out, by the extra of pyproject.toml that has them."""

from __future__ import annotations

from importlib.util import find_spec

from .errors import InputError

EXTRAS = {
    "campaign": ("pyarrow",),
    "cluster": ("distributed",),
    "html": ("latex2mathml",),
    "identify": ("pandas",),
}


def check_extra(name: str, wanted_by: str, otherwise: str = "") -> None:
    """InputError, which begins with `wanted_by`, where a package of the extra `name` is not installed.

    `otherwise` says what could be done instead.
    """
    for package in EXTRAS[name]:
        if find_spec(package) is None:
            raise InputError(f'{wanted_by}: {package} is not installed; pip install "railslip_ctrl[{name}]"{otherwise}')
