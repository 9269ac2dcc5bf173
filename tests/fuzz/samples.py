"""Valid files of every format, small and of many kinds: the fuzz starts from these."""

import io

import numpy as np

from clbvh import make_shape

from ..unit.geometry.gltf_files import CODES, Gltf
from ..unit.geometry.test_ply import make_ply
from ..unit.geometry.test_stl_off import facet, make_stl

_SPHERE = make_shape("icosphere", triangles=20)
_VERTICES, _FACES = _SPHERE.vertices, _SPHERE.faces
_POLYGONS = [[0, 1, 2], [3, 4, 5, 6], [7, 8, 9, 10, 11], [2, 1, 0]]
_SURVEY = _VERTICES * 1e-3 + [5e6, 6e6, 300]


def _join(rows) -> str:
    return "".join(
        " ".join(f"{value:.9g}" if isinstance(value, float) else str(value) for value in row) + "\n" for row in rows
    )


_POINTS = _join(_VERTICES.tolist())
_COUNTED = [_join([len(face), *face] for face in faces) for faces in (_FACES.tolist(), _POLYGONS)]


def _make_ply() -> list[bytes]:
    faces, double = _FACES.tolist(), ("double", "uchar", "int")
    return [
        make_ply(faces, vertices=_VERTICES),
        make_ply(_POLYGONS, vertices=_VERTICES, types=double, extra=True),
        make_ply(faces, "binary_little_endian", vertices=_VERTICES),
        make_ply(_POLYGONS, "binary_big_endian", vertices=_VERTICES, types=double),
        make_ply(faces, "binary_little_endian", vertices=_SURVEY, types=double, extra=True),
    ]


def _make_obj() -> list[bytes]:
    vertices = "".join(f"v {line}\n" for line in _POINTS.splitlines())
    faces = "".join(f"f {a} {b} {c}\n" for a, b, c in _FACES + 1)
    polygons = "".join("f " + " ".join(f"{at + 1}/1/{at}" for at in polygon) + "\n" for polygon in _POLYGONS)
    parts = "o one\nv 0 0 0 1 0.5 0.5\nv 1 0 0\nv 0 1 0 1\nusemtl red\nf -3 -2 \\\n -1\n"
    parts += "o two\nv 0 0 1\nf -1//1 1//1 2//2\nl 1 2\n"
    texts = vertices + faces, "# by hand\nmtllib a.mtl\nvn 0 0 1\nvt 0 0\n" + vertices + polygons, parts
    return [*[text.encode() for text in texts], texts[1].encode("utf-16")]


def _make_stl() -> list[bytes]:
    corners = _VERTICES[_FACES]

    def write(name: str, triangles: np.ndarray) -> bytes:
        return f"solid {name}\n{''.join(map(facet, triangles))}endsolid {name}\n".encode()

    texts = write("ball", corners), write("a", corners[:2]) + write("b vertex", corners[2:4])
    return [make_stl(7, b"solid but binary", corners), make_stl(0, b"", corners) + b"by hand", *texts]


def _make_off() -> list[bytes]:
    coloured = [_join([*row, *colour] for row in rows) for rows, colour in (
        (_VERTICES.tolist(), [200, 100, 0, 255]), ([[len(p), *p] for p in _POLYGONS], [0.5, 0.5, 0.5]),
    )]  # fmt: skip
    return [
        f"OFF\n12 20 0\n{_POINTS}{_COUNTED[0]}".encode(),
        "# by hand\nCOFF 12 4 0\n{}\n{}".format(*coloured).encode(),
        f"off12 4\n0\n{_POINTS}{_COUNTED[1]}".encode(),
    ]


def make_gltf_documents() -> list[Gltf]:
    """Return documents that together use every feature that is read."""
    plain = Gltf()
    plain.add_part(_VERTICES, _FACES)

    graph = Gltf()
    leaf = graph.add_part(_VERTICES[:4], [[0, 1, 2], [1, 2, 3]], node={"is_root": False, "rotation": [0, 0, 0.6, 0.8]})
    inner = graph.add_node(is_root=False, children=[leaf], matrix=np.diag([2.0, -1, 1, 1]).ravel().tolist())
    graph.add_node(mesh=0, children=[inner], translation=[1, 2, 3], scale=[1, 1, 0.5])
    graph.add_part(_VERTICES[:5], None, mode=5, material=0)
    graph.add_part(_VERTICES[:5], [4, 3, 2, 1, 0], mode=6)
    graph.add_part(_VERTICES[:4], None, mode=1)

    packed = Gltf()
    packed.document |= {"extensionsUsed": ["KHR_mesh_quantization"], "extensionsRequired": ["KHR_mesh_quantization"]}
    positions = packed.add_accessor(np.rint(_VERTICES * 100), "i1", normalized=True)
    places, values = np.array([1, 3], "<u2").tobytes(), np.ones((2, 3), "<i1").tobytes()
    packed.document["accessors"][positions]["sparse"] = {
        "count": 2,
        "indices": {"bufferView": packed.add_view(places), "componentType": CODES["u2"]},
        "values": {"bufferView": packed.add_view(values), "byteOffset": 0},
    }
    indices = packed.add_accessor(_FACES.ravel(), "u1")
    primitive = {"attributes": {"POSITION": positions}, "indices": indices, "mode": 4}
    packed.add_node(mesh=packed.add_mesh(primitive, primitive))
    view = packed.add_view(np.column_stack((_VERTICES, _VERTICES)).astype("<f4").tobytes(), byteStride=24)
    accessor = {"bufferView": view, "byteOffset": 12, "componentType": CODES["f4"], "count": 12, "type": "VEC3"}
    packed.document["accessors"].append(accessor)
    packed.add_node(mesh=packed.add_mesh({"attributes": {"POSITION": 2}}))

    skinned = Gltf()
    attributes = {"POSITION": skinned.add_accessor(_VERTICES, "f4"), "NORMAL": skinned.add_accessor(_VERTICES, "f4")}
    attributes["JOINTS_0"] = skinned.add_accessor(np.tile([0, 1, 0, 0], (12, 1)), "u1")
    attributes["WEIGHTS_0"] = skinned.add_accessor(np.tile([200, 55, 0, 0], (12, 1)), "u1", normalized=True)
    bound = skinned.add_accessor(np.tile(np.eye(4).ravel(), (2, 1)), "f4")
    skinned.document["skins"] = [{"joints": [0, 1], "inverseBindMatrices": bound}]
    skinned.add_node(children=[1], scale=[0.5, 2, 1])
    skinned.add_node(is_root=False, translation=[1, 2, 3])
    skinned.add_node(mesh=skinned.add_mesh({"attributes": attributes}), skin=0, scale=[0, 0, 0])
    skinned.add_part(_VERTICES, _FACES, node={"extensions": {"KHR_node_visibility": {"visible": False}}})
    return [plain, graph, packed, skinned]


_WHOLE_SCENE = """[[object]]
shape = "knot"
triangles = 1000
seed = 3
strands = 4
rotate = [0, 90, 0]
translate = [1, 2, 3.5]
[view]
eye = [0, 0, 9]
look_at = [0, 1, 0]
fov = 40
cut = "z=50%"
width = 64
shading = "lambert"
background = [[0, 0, 0], [1, 1, 1]]
light = {direction = [1, 1, 0], colour = [1, 1, 1], sky = [0.1, 0.2, 0.3], ground = [0, 0, 0]}
wireframe = {width = 2}
"""
_OBJECTS = """[[object]]
label = "ground"
shape = "terrain"
triangles = 200
scale = [2, 1, 2]
[[object]]
shape = "icosphere"
triangles = 20
mask = 3
matrix = [[0, 0, 1, 0], [1, 0, 0, 0.5], [0, 1, 0, 0], [0, 0, 0, 1]]
repeat = {on = "ground", count = 12, seed = 4, scale = [0.5, 2], align = "normal", turn = true}
[[object]]
spheres = "galaxy"
count = 30
repeat = {grid = [2, 1, 3], spacing = [1, 0, 2.5]}
[[object]]
centres = [[0, 0, 0], [1, 2, 3.5]]
radii = [1, 0.5]
[view]
up = "z"
projection = "fisheye:220"
"""
_SHAPES = ("terrain", "blobs", "boxes", "icosphere", "palace")


def _make_spheres_archives() -> list[bytes]:
    files = []
    for save, dtype in ((np.savez, "<f8"), (np.savez_compressed, "<f4"), (np.savez, ">i4")):
        file = io.BytesIO()
        save(file, centres=np.rint(_VERTICES * 4).astype(dtype), radii=np.arange(1, len(_VERTICES) + 1).astype(dtype))
        files.append(file.getvalue())
    return files


def _make_spheres_tables() -> list[bytes]:
    rows = "".join(f"{x:.6g},{y:.6g},{z:.6g},0.5\n" for x, y, z in _SURVEY)
    return [rows.encode(), b"x,y,z,radius\n# by hand\n" + rows.encode(), b"1, 2, 3\r\n4, 5e-3, 6\r\n"]


MESH_FILES = {"ply": _make_ply(), "obj": _make_obj(), "stl": _make_stl(), "off": _make_off()}
_SHAPE_SCENES = [f'[[object]]\nshape = "{shape}"\ntriangles = 400\n' for shape in _SHAPES]
SCENE_FILES = [text.encode() for text in (_WHOLE_SCENE, _OBJECTS, *_SHAPE_SCENES)]
SPHERES_FILES = {"npz": _make_spheres_archives(), "csv": _make_spheres_tables()}
