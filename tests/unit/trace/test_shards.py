"""A mesh in shards: the answers of the whole mesh, byte for byte, and folders that are damaged."""

import json
import shutil

import numpy as np
import pytest

import clbvh
import clbvh.geometry.shards
import clbvh.trace.shards

SHARDS = 7


def soup(seed, shift):
    """Scattered triangles, every 17th of which has no area; some are the only ones far out."""
    random = np.random.default_rng(seed)
    corners = random.uniform(-1, 1, (2000, 1, 3)) + random.normal(0, 0.08, (2000, 3, 3))
    faces = np.arange(6000).reshape(-1, 3)
    faces[::17, 2] = faces[::17, 1]
    corners[17] *= 3
    return clbvh.Mesh.from_arrays(corners.reshape(-1, 3) + shift, faces, name="soup")


def grid():
    """A square of 2,048 triangles on whole numbers, whose edges and vertices rays can meet exactly."""
    x, y = np.meshgrid(np.arange(33.0), np.arange(33.0))
    first = (np.arange(32)[:, None] * 33 + np.arange(32)).reshape(-1, 1)
    faces = np.random.default_rng(0).permutation(
        np.vstack([first + np.array(corners) for corners in ([0, 1, 34], [0, 34, 33])])
    )
    return clbvh.Mesh.from_arrays(np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3), faces, name="grid")


MESHES = {
    "soup-1": lambda: soup(1, 0.0),
    "soup-2-far": lambda: soup(2, 1e7),
    "terrain": lambda: clbvh.make_shape("terrain", triangles=2000),
    "grid": grid,
}


@pytest.fixture(params=MESHES, scope="module")
def mesh(request):
    return MESHES[request.param]()


@pytest.fixture(scope="module")
def folder(mesh, tmp_path_factory):
    parts = tmp_path_factory.mktemp("shards") / "parts"
    shards = clbvh.shard_mesh(mesh, parts, triangles=-(-mesh.face_count // SHARDS))
    assert len(shards) == SHARDS
    assert sum(shard.triangle_count for shard in shards) == mesh.face_count
    return parts


def make_rays(mesh, count, seed=0):
    """Rays at vertices and beside them, a tenth of them from far away, and through vertices along an axis."""
    random = np.random.default_rng(seed)
    size = 1 / mesh.scale
    origins = mesh.origin + random.normal(size=(count, 3)) * size * np.where(random.random((count, 1)) < 0.1, 1e4, 1)
    targets = mesh.vertices[random.integers(len(mesh.vertices), size=count)]
    targets[::2] = mesh.origin + random.uniform(-1, 1, (len(targets[::2]), 3)) * size
    directions = targets - origins
    directions[1::4] = [0, 0, 1.5]
    origins[1::4] = targets[1::4] - [0, 0, 3]
    return origins, directions, targets


def assert_same(found, expected, names):
    for name in names.split():
        one, other = getattr(found, name), getattr(expected, name)
        assert (one.dtype, one.shape) == (other.dtype, other.shape), name
        assert one.tobytes() == other.tobytes(), name


def assert_all_alike(sharded, whole, mesh, count):
    origins, directions, targets = make_rays(mesh, count)
    for limits in ({}, {"t_min": 0.5, "t_max": np.linspace(0.4, 1.5, count)}):
        hits, expected = (one.closest_hit(origins, directions, **limits) for one in (sharded, whole))
        assert hits.mesh is None
        assert hits.count > 0
        assert_same(hits, expected, "t u v prim_id is_front instance_id geometry_id locations normals")
        # But for those that the whole mesh moves along their triangle, away from a wall that may be in another shard.
        starts = [one.offset_origins() for one in (hits, expected)]
        moves = starts[1] - expected.locations
        sideways = np.linalg.norm(np.cross(moves, expected.normals), axis=1) > 1e-3 * np.linalg.norm(moves, axis=1)
        assert sideways.mean() < 0.1
        assert starts[0][~sideways].tobytes() == starts[1][~sideways].tobytes()
        assert_same(sharded.closest_prim(origins, directions, **limits), hits.prim_id, "T")
        assert_same(sharded.any_hit(origins, directions, **limits), hits.is_hit, "T")
        for most in (None, 1, 3):
            named = {**limits, "max_hits": most}
            counts, every = whole.count_hits(origins, directions, **named), whole.all_hits(origins, directions, **named)
            assert_same(sharded.count_hits(origins, directions, **named), counts, "T")
            found = sharded.all_hits(origins, directions, **named)
            assert_same(found, every, "t u v prim_id is_front offsets locations")
    for points in (origins, targets, targets + (origins - targets) * 1e-3, mesh.origin):
        assert_same(sharded.closest_point(points), whole.closest_point(points), "distance point prim_id instance_id")


@pytest.mark.parametrize(
    ("layout", "quality", "count"),
    [("auto", "default", 40), ("auto", "default", 2400), ("bvh2", "fast", 2400), ("bvh8c", "default", 2400)],
)
def test_the_answers_are_those_of_the_whole_mesh(mesh, folder, layout, quality, count):
    with (
        clbvh.ShardedTracer(folder, layout=layout, quality=quality) as sharded,
        clbvh.Tracer(mesh, layout=layout, quality=quality) as whole,
    ):
        assert_all_alike(sharded, whole, mesh, count)


@pytest.mark.parametrize("seed", range(2))
def test_the_order_of_the_shards_does_not_matter(mesh, folder, seed, monkeypatch):
    compare = clbvh.ShardedTracer._compare

    def shuffle(*arguments):
        bits, order = compare(*arguments)
        return bits, np.random.default_rng(seed).permutation(order).tolist()

    monkeypatch.setattr(clbvh.ShardedTracer, "_compare", shuffle)
    with clbvh.ShardedTracer(folder) as sharded, clbvh.Tracer(mesh) as whole:
        assert_all_alike(sharded, whole, mesh, 1500)


def test_edges_and_corners_on_the_border_of_shards_count_once_and_the_smallest_face_wins(tmp_path):
    mesh = grid()
    clbvh.shard_mesh(mesh, tmp_path / "parts", triangles=50)
    x, y = np.meshgrid(np.arange(0.0, 32.5, 0.5), np.arange(0.0, 32.5, 0.5))
    origins = np.stack([x, y, np.ones_like(x)], axis=-1)
    with clbvh.ShardedTracer(tmp_path / "parts") as tracer:
        assert (tracer.count_hits(origins, [0, 0, -1]) == 1).all()
        nearest = tracer.closest_point(origins).prim_id
    boxes = mesh.vertices[mesh.faces]
    holds = [
        ((boxes.min(axis=1) <= p) & (p <= boxes.max(axis=1))).all(axis=1) for p in origins.reshape(-1, 3) * [1, 1, 0]
    ]
    # A box of two triangles holds a point of either; on a diagonal, or on a side, all of them are as near.
    is_corner = ((x % 1 == 0) & (y % 1 == 0)).reshape(-1)
    on_corner = [
        np.flatnonzero((boxes == p * [1, 1, 0]).all(axis=2).any(axis=1)).min()
        for p in origins.reshape(-1, 3)[is_corner]
    ]
    assert (nearest.reshape(-1)[is_corner] == on_corner).all()
    assert all(held[prim] for held, prim in zip(holds, nearest.reshape(-1), strict=True))


def test_some_of_the_shards_in_each_process_make_the_whole(mesh, folder):
    origins, directions, _ = make_rays(mesh, 1500)
    with clbvh.Tracer(mesh) as whole:
        expected = whole.count_hits(origins, directions)
    counts = np.zeros_like(expected)
    for chosen in (0, [3, 1], [2, 4, 5, 6]):
        with clbvh.ShardedTracer(folder, shards=chosen) as tracer:
            counts += tracer.count_hits(origins, directions)
    assert (counts == expected).all()
    with pytest.raises(clbvh.ConfigError, match="numbers of the 7"):
        clbvh.ShardedTracer(folder, shards=[7])


def test_a_shard_leaves_the_device_before_the_next_one_is_there(folder, mesh, monkeypatch):
    counts = []
    release = clbvh.ShardedTracer._release

    def count_buffers(self):
        session = None if self._opened is None else self._opened.caster.session
        release(self)
        counts.append(0 if session is None else session.buffer_count)

    monkeypatch.setattr(clbvh.ShardedTracer, "_release", count_buffers)
    with clbvh.ShardedTracer(folder) as tracer:
        tracer.closest_hit(*make_rays(mesh, 1500)[:2])
    assert len(counts) > SHARDS / 2
    assert not any(counts)


def test_a_mask_of_zero_sees_nothing_and_progress_ends_with_all(mesh, folder):
    origins, directions = make_rays(mesh, 300)[:2]
    mask = np.random.default_rng(1).integers(0, 3, len(origins))
    done = []
    with clbvh.ShardedTracer(folder) as sharded, clbvh.Tracer(mesh) as whole:
        for name in ("closest_hit", "closest_prim", "any_hit", "count_hits", "all_hits"):
            ask = [
                getattr(each, name)(origins, directions, mask=mask, progress=lambda *told: done.append(told))
                for each in (sharded, whole)
            ]
            expected = ask[1].t if hasattr(ask[1], "t") else ask[1]
            assert np.array_equal(ask[0].t if hasattr(ask[0], "t") else ask[0], expected), name
            assert done[-1] == (300, 300)
        near = sharded.closest_point(origins, mask=mask, progress=lambda *told: done.append(told))
        assert_same(near, whole.closest_point(origins, mask=mask), "distance point prim_id instance_id")
        assert (near.prim_id[mask == 0] == -1).all()
        assert len({count for count, _ in done}) > 3


def test_a_bad_ray_or_a_closed_tracer_is_refused_and_the_next_query_works(folder, mesh):
    with clbvh.ShardedTracer(folder) as tracer:
        for _ in range(2):
            with pytest.raises(clbvh.QueryError, match=r"origins\[1\] is not finite"):
                tracer.any_hit([[0, 0, 0], [np.nan, 0, 0]], [[0, 0, 1]])
            with pytest.raises(clbvh.QueryError, match=r"points\[1\] is not finite"):
                tracer.closest_point([[0, 0, 0], [np.nan, 0, 0]])
        hits = tracer.closest_hit(*make_rays(mesh, 10)[:2])
        with pytest.raises(clbvh.ConfigError, match="do not know the whole mesh"):
            _ = hits.part_id
    assert tracer.is_closed
    for count in (10, 0):
        with pytest.raises(clbvh.QueryError, match="closed"):
            tracer.closest_hit(*(rays[:count] for rays in make_rays(mesh, 10)[:2]))


def flip(path, share):
    data = bytearray(path.read_bytes())
    data[int(len(data) * share)] ^= 16
    path.write_bytes(data)


def change_index(path, change):
    index = json.loads(path.read_text())
    change(index)
    path.write_text(json.dumps(index))


def other_shards(parts):
    """Return a folder whose shards have as many triangles each."""
    mesh, other = MESHES["terrain"](), parts.parent / "other"
    shards = clbvh.shard_mesh(mesh.with_vertices(mesh.vertices * [1, 1.001, 1]), other, triangles=300)
    expected = json.loads((parts / "shards.json").read_text())["shards"]
    assert [shard.triangle_count for shard in shards] == [each["triangles"] for each in expected]
    return other


DAMAGE = {
    "no list": lambda parts: (parts / "shards.json").unlink(),
    "half a list": lambda parts: (parts / "shards.json").write_text((parts / "shards.json").read_text()[:300]),
    "no object": lambda parts: (parts / "shards.json").write_text("[1]"),
    "another box": lambda parts: change_index(
        parts / "shards.json", lambda index: index["shards"][3].update(box=index["shards"][2]["box"])
    ),
    "another format": lambda parts: change_index(parts / "shards.json", lambda index: index.update(format=9)),
    "no shard": lambda parts: (parts / "shard-0003.npz").unlink(),
    "no archive": lambda parts: (parts / "shard-0003.npz").write_bytes(b"PK\3\4 nothing"),
    "half a shard": lambda parts: (parts / "shard-0003.npz").write_bytes(
        (parts / "shard-0003.npz").read_bytes()[:9000]
    ),
    "a wrong vertex": lambda parts: flip(parts / "shard-0003.npz", 0.8),
    "a wrong face": lambda parts: flip(parts / "shard-0003.npz", 0.15),
    "another shard": lambda parts: shutil.copy(parts / "shard-0002.npz", parts / "shard-0003.npz"),
    "a shard of another mesh": lambda parts: shutil.copy(other_shards(parts) / "shard-0003.npz", parts),
    "an archive of objects": lambda parts: np.savez(parts / "shard-0003.npz", prim_ids=np.array([None])),
    "other arrays": lambda parts: np.savez(parts / "shard-0003.npz", faces=np.zeros((1, 3), int)),
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_a_damaged_folder_is_refused_by_the_name_of_the_file(damage, tmp_path):
    mesh = MESHES["terrain"]()
    parts = tmp_path / "parts"
    clbvh.shard_mesh(mesh, parts, triangles=300)
    DAMAGE[damage](parts)
    name = "shards.json" if damage in list(DAMAGE)[:5] else "shard-0003.npz"
    with pytest.raises(clbvh.MeshError, match=name), clbvh.ShardedTracer(parts) as tracer:
        tracer.any_hit(mesh.vertices + np.array([0, 9, 0]), [[0, -1, 0.01]])


def test_a_damaged_tree_is_built_again(tmp_path):
    mesh = MESHES["terrain"]()
    clbvh.shard_mesh(mesh, tmp_path / "parts", triangles=300)
    origins, directions, _ = make_rays(mesh, 1500)
    answers = []
    for _ in range(2):
        with clbvh.ShardedTracer(tmp_path / "parts") as tracer:
            answers.append(tracer.closest_hit(origins, directions).t.tobytes())
        trees = sorted((tmp_path / "parts").glob("*.default.tree"))
        assert len(trees) == len(tracer.shards)
        flip(trees[2], 0.5)
    assert answers[0] == answers[1]


def write_ply(path, mesh, order="<", extra=False):
    """Write a PLY file of triangles, whose vertices are float32, with more properties."""
    vertex = [("x", order + "f4"), ("y", order + "f4"), ("z", order + "f4"), *([("red", "u1")] if extra else [])]
    face = [("count", "u1"), ("ids", order + "i4", 3), *([("flags", order + "i2")] if extra else [])]
    vertices, faces = np.zeros(len(mesh.vertices), vertex), np.zeros(mesh.face_count, face)
    for axis, name in enumerate("xyz"):
        vertices[name] = mesh.vertices[:, axis]
    faces["count"], faces["ids"] = 3, mesh.faces
    kind = {"<": "binary_little_endian", ">": "binary_big_endian"}[order]
    lines = [f"ply\nformat {kind} 1.0\nelement vertex {len(vertices)}"]
    lines += [f"property float {axis}" for axis in "xyz"] + (["property uchar red"] if extra else [])
    lines += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
    lines += ["property short flags"] if extra else []
    path.write_bytes("\n".join([*lines, "end_header\n"]).encode() + vertices.tobytes() + faces.tobytes())


@pytest.mark.parametrize(("order", "extra"), [("<", False), ("<", True), (">", False)])
def test_a_streamed_file_has_the_shards_of_its_mesh_in_memory(order, extra, mesh, tmp_path, monkeypatch):
    write_ply(tmp_path / "mesh.ply", mesh, order, extra)
    loaded = clbvh.load_mesh(tmp_path / "mesh.ply")
    clbvh.shard_mesh(loaded, tmp_path / "memory", triangles=300)
    monkeypatch.setattr(clbvh.geometry.shards, "_CHUNK_ROWS", 97)
    if order == "<":
        monkeypatch.setattr(clbvh.geometry.shards, "as_mesh", lambda _: pytest.fail("it is loaded as a whole"))
    clbvh.shard_mesh(str(tmp_path / "mesh.ply"), tmp_path / "streamed", triangles=300)
    files = {path.name: path.read_bytes() for path in (tmp_path / "memory").iterdir()}
    assert files == {path.name: path.read_bytes() for path in (tmp_path / "streamed").iterdir()}
    assert sorted(path.name for path in tmp_path.iterdir()) == ["memory", "mesh.ply", "streamed"]


def test_what_cannot_be_cut_leaves_nothing_behind(tmp_path):
    mesh = MESHES["terrain"]()
    write_ply(tmp_path / "mesh.ply", mesh)
    data = (tmp_path / "mesh.ply").read_bytes()
    for damaged, said in ((data[:-1], "cut off"), (data[:-4] + b"\xff\xff\xff\x7f", "face 1983 refers to vertex")):
        (tmp_path / "mesh.ply").write_bytes(damaged)
        with pytest.raises(clbvh.MeshError, match=f"mesh.ply.*{said}"):
            clbvh.shard_mesh(tmp_path / "mesh.ply", tmp_path / "parts", triangles=300)
    for folder, triangles in ((tmp_path, 300), (tmp_path / "gone" / "parts", 300), (tmp_path / "parts", 0)):
        with pytest.raises(clbvh.ConfigError):
            clbvh.shard_mesh(mesh, folder, triangles=triangles)
    assert [path.name for path in tmp_path.iterdir()] == ["mesh.ply"]
