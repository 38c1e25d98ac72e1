"""Search strategies as ask/tell: vectors out, returns in, random generator passed in; no I/O, no clock."""

from enum import StrEnum


class SearchName(StrEnum):
    """The searches, listed here so that --help need not import them.

    ``some-name`` is ``SEARCH`` of the module ``some_name`` of this folder: a new search is one file, and one
    line here.
    """

    GAUSS_NEWTON = "gauss-newton"
    PUBLISHED = "published"
    ALGORITHM1 = "algorithm1"
