"""Search strategies as ask/tell: vectors out, returns in, random generator passed in; no I/O, no clock."""

from enum import StrEnum


class SearchName(StrEnum):
    """The search strategies; listed here so that --help need not import them."""

    GAUSS_NEWTON = "gauss-newton"
    PUBLISHED = "published"
    ALGORITHM1 = "algorithm1"
