"""Queries of all kinds and sizes, and their answers as bytes."""

from dataclasses import is_dataclass

import numpy as np

KINDS = (
    "closest_hit", "closest_prim", "any_hit", "count_hits", "all_hits",
    "closest_point", "contains", "signed_distance",
)  # fmt: skip
OF_POINTS = KINDS[-3:]


def make_queries(mesh, sizes, seed):
    """Return (kind, arguments) of each kind and size, in a random order."""
    generator = np.random.default_rng(seed)
    lower, upper = mesh.vertices.min(axis=0) + mesh.origin, mesh.vertices.max(axis=0) + mesh.origin
    queries = []
    for kind in KINDS:
        for size in sizes:
            points = generator.uniform(lower, upper, (size, 3))
            queries.append((kind, (points,) if kind in OF_POINTS else (points, generator.normal(size=(size, 3)))))
    return [queries[index] for index in generator.permutation(len(queries))]


def ask(tracer, kind, arguments, **options):
    """Return the answer to a query, as bytes."""
    answer = getattr(tracer, kind)(*arguments, **options)
    if is_dataclass(answer):
        answer = [getattr(answer, name) for name in ("t", "u", "v", "prim_id", "instance_id", "offsets", "distance",
                                                  "point") if hasattr(answer, name)]  # fmt: skip
    if not isinstance(answer, (list, tuple)):
        answer = [answer]
    return [part.tobytes() for part in answer if part is not None]
