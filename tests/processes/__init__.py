"""Tests in processes of their own, a lane by itself: `make test-processes`."""
