"""Room for results: a few numbers can be broadcast to more rays than have room in memory."""

from __future__ import annotations

from ..errors import QueryError
from ..support.memory import check_memory


def check_room(count: int, bytes_of_each: int, subject: str = "rays") -> None:
    """Raise `QueryError` if the results of rays or points do not fit the free memory."""
    advice = f"ask for fewer {subject} at a time"
    check_memory(f"the results of {count:,} {subject}", count * bytes_of_each, QueryError, advice)
