"""Tests in processes of their own, a lane by itself: `make test-processes`."""

from .sessions import list_session, start_script, wait_until

__all__ = ["list_session", "start_script", "wait_until"]
