"""The worker processes of a build: a pool whose workers have the compiled builder in memory."""

from __future__ import annotations

from .workers.pool import DEFAULT_TIMEOUT_S, WorkerPool


class SubtreePool(WorkerPool):
    """Worker processes that build subtrees.

    They start in the background at once, by a fork server (or by spawning where there is none): never by forking this
    process, whose OpenCL driver may run threads that a fork would cut off. Use it as a context manager, for as many
    builds as you like.

    Parameters
    ----------
    workers : int, optional
        Number of processes; the number of usable processors without it.
    timeout_s : float, optional
        Seconds, above 0, after which a worker that does not answer counts as dead.

    Raises
    ------
    ConfigError
        A number of workers below 1 or above 1024, or a timeout that is not above 0.
    PoolError
        From `wait_ready` and from any use: the workers did not start, one of them failed or died. The pool is
        closed then, and cannot be used again. From the end of a `with` block, when the script has no guard (see
        below) and nothing in the block has told.

    Notes
    -----
    Workers import the main script, as all of `multiprocessing` does, so a script that creates a pool must do it
    under ``if __name__ == "__main__":``.

    Examples
    --------
    >>> import clbvh
    >>> mesh = clbvh.make_shape("icosphere", triangles=30_000)
    >>> with clbvh.SubtreePool(workers=2) as pool:
    ...     bvh = clbvh.build(mesh, pool=pool)
    >>> bvh.nodes.tobytes() == clbvh.build(mesh).nodes.tobytes()
    True
    """

    def __init__(self, workers: int | None = None, *, timeout_s: float = DEFAULT_TIMEOUT_S) -> None:
        super().__init__(workers, timeout_s=timeout_s, preload="clbvh.builders.preload")
