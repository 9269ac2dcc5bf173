"""Meshes whose arrays are on a device: they are checked and brought to local coordinates there.

The bytes of the local coordinates are those of `Mesh.from_arrays`. Must not know of trees.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..device.info import DeviceInfo
from ..device.open import open_device
from ..device.select import choose_device
from ..device.session import DeviceSession
from ..geometry import Mesh, MeshLike, Shape, as_mesh
from ..geometry.arrays import is_device_array, wait_for
from ..geometry.as_mesh import as_shape
from ..geometry.local_frame import find_frame
from ..geometry.mesh import MAX_FACE_COUNT

_WORK_GROUP = (64,)

# Work-items that look for the bounds; the host unites what they have seen.
_BOUND_ITEMS = 1024


class DeviceMesh(Mesh):
    """A mesh on a device. The host downloads those of its arrays that it reads, once.

    It has copies on the device, so that whoever wrote the arrays may write them again.
    """

    session: DeviceSession
    # Of each field: the buffer, the dtype, and the number of rows.
    _stored: dict[str, tuple[Any, np.dtype, int]]

    @classmethod
    def take(cls, session: DeviceSession, vertices: Any, faces: Any, like: Mesh | None = None) -> DeviceMesh | None:
        """Return the mesh of arrays on a device.

        Parameters
        ----------
        session : DeviceSession
            In the context of the arrays.
        vertices : pyopencl.array.Array
            (V, 3) float32 or float64.
        faces : pyopencl.array.Array or None
            (F, 3) int32 or uint32; None for those of `like`.
        like : Mesh, optional
            The mesh before its vertices moved.

        Returns
        -------
        DeviceMesh or None
            None where the device cannot take the arrays, or they are wrong: a host must look at them.

        Raises
        ------
        MeshError
            The box is too small or too large, see `Mesh.from_arrays`.
        """
        is_known = _is_rows(vertices, "f4", "f8") and (faces is None or _is_rows(faces, "i4", "u4"))
        if not session.info.has_fp64 or not is_known or (faces is not None and len(faces) > MAX_FACE_COUNT):
            return None
        name = "mesh" if like is None else like.name
        stored = {} if like is None else dict(vars(like).get("_stored", {}))
        stored["vertices"] = _copy(session, vertices), vertices.dtype, len(vertices)
        if faces is not None:
            stored["faces"] = _copy(session, faces), np.dtype(np.int32), len(faces)
        bounds = _find_bounds(session, stored, has_new_faces=faces is not None)
        if bounds is None:
            return None
        lower, upper = bounds[:, 0].min(axis=0), bounds[:, 1].max(axis=0)
        origin, scale = find_frame(lower, upper, name, subject="the mesh is")
        local = session.allocate(12 * len(vertices))
        x, y, z = origin
        session.run(
            _kernels(session, vertices.dtype)["localize"], (len(vertices),), _WORK_GROUP,
            vertices=stored["vertices"][0], vertex_count=np.int32(len(vertices)), x=x, y=y, z=z,
            scale=np.float64(scale), local_vertices=local,
        )  # fmt: skip
        stored["local_vertices"] = local, np.dtype(np.float32), len(vertices)
        session.finish()

        mesh = cls.__new__(cls)
        box = ((np.stack((lower, upper)) - origin) * scale).astype(np.float32)
        vars(mesh).update(session=session, _stored=stored, origin=origin, scale=scale, name=name, local_box=box)
        # The host has not looked at its faces.
        vars(mesh)["spans_scales"] = False
        if like is not None:
            appearance = None if like.appearance is None else like.appearance.without_normals()
            vars(mesh).update(appearance=appearance, parts=like.parts)
            if "faces" in vars(like):
                vars(mesh)["faces"] = like.faces
        return mesh

    def __getattr__(self, name: str) -> Any:
        # Only where the host has no such field yet.
        stored = vars(self).get("_stored", {})
        if name not in stored:
            raise AttributeError(f"a mesh has no '{name}'")
        buffer, dtype, count = stored[name]
        array = np.empty((count, 3), dtype)
        with self.session.branch() as session:
            session.download(buffer, array)
        value = array.astype(np.float64) if name == "vertices" else array
        return vars(self).setdefault(name, value)

    def __reduce__(self) -> tuple[Any, ...]:
        fields = self.vertices, self.faces, self.local_vertices, self.origin, self.scale
        return Mesh, (*fields, self.name, self.appearance, self.parts)

    @property
    def face_count(self) -> int:
        """Number of triangles, degenerate ones included."""
        return _count_rows(self, "faces")

    @property
    def prim_count(self) -> int:
        """Number of primitives: its triangles."""
        return _count_rows(self, "faces")

    @property
    def has_doubles(self) -> bool:
        """Whether its vertices on the device are float64, else float32."""
        return bool(self._stored["vertices"][1] == np.float64)

    def buffer_on(self, session: DeviceSession, name: str) -> Any:
        """Return the buffer of a field, or None where a session does not see it."""
        stored = vars(self).get("_stored", {})
        return stored[name][0] if name in stored and self.session.context == session.context else None


def take_mesh(source: MeshLike, device: DeviceInfo | str | int | None) -> Mesh:
    """Return the mesh that a user means, see `as_mesh`; arrays stay where they are if that is the wanted device."""
    return _take_arrays(source, device) if _is_on_device(source) else as_mesh(source)


def take_shape(source: Shape | MeshLike, device: DeviceInfo | str | int | None, *, or_else: str) -> Shape:
    """Return the mesh or the spheres that a user means, see `as_shape`; arrays of a mesh as `take_mesh`."""
    return _take_arrays(source, device) if _is_on_device(source) else as_shape(source, or_else=or_else)


def _is_on_device(source: Any) -> bool:
    return isinstance(source, tuple | list) and len(source) == 2 and any(map(is_device_array, source))


def _take_arrays(source: Any, device: DeviceInfo | str | int | None) -> Mesh:
    vertices, faces = source
    mesh = None
    if is_device_array(vertices) and is_device_array(faces) and vertices.context == faces.context:
        # Imported here: without arrays on a device nobody needs OpenCL.
        from ..device.opencl_session import OpenclSession

        session: DeviceSession = OpenclSession.in_context(vertices.context)
        if _is_meant(session.info, device):
            mesh = DeviceMesh.take(session, vertices, faces)
    return Mesh.from_arrays(vertices, faces) if mesh is None else mesh


def move_mesh(mesh: Mesh, vertices: Any, session: DeviceSession) -> Mesh:
    """Return a mesh with other vertices, see `Mesh.with_vertices`; those in the session's context stay there."""
    moved = None
    is_here = is_device_array(vertices) and vertices.context == session.context
    if is_here and vertices.shape == (_count_rows(mesh, "vertices"), 3):
        # Of its own: a mesh outlives the tracer that a session belongs to.
        own = mesh.session if isinstance(mesh, DeviceMesh) and mesh.session.context == session.context else None
        moved = DeviceMesh.take(own or session.branch(), vertices, None, mesh)
    return mesh.with_vertices(vertices) if moved is None else moved


def open_session(shape: Any, device: DeviceInfo | str | int | None) -> DeviceSession:
    """Return a session that sees a shape on a device, or a session on the device that is asked for."""
    session = vars(shape).get("session") if isinstance(shape, DeviceMesh) else None
    return open_device(device) if session is None or not _is_meant(session.info, device) else session.branch()


def _is_meant(info: DeviceInfo, device: DeviceInfo | str | int | None) -> bool:
    """Return whether a device is the one that a user asks for, if any."""
    return device is None or info == (device if isinstance(device, DeviceInfo) else choose_device(device))


def _count_rows(mesh: Mesh, name: str) -> int:
    stored = vars(mesh).get("_stored", {})
    return stored[name][2] if name in stored else len(getattr(mesh, name))


def _is_rows(array: Any, *dtypes: str) -> bool:
    """Return whether an array has packed rows of three numbers, one at least."""
    is_packed = array.ndim == 2 and array.shape[1] == 3 and len(array) > 0 and array.flags.c_contiguous
    return is_packed and array.dtype in [np.dtype(dtype) for dtype in dtypes]


def _copy(session: DeviceSession, array: Any) -> Any:
    """Return a new buffer with the numbers of an array, once those who write it are done."""
    wait_for(array)
    buffer = session.allocate(array.nbytes)
    session.copy(array.base_data, buffer, array.nbytes, source_begin=array.offset)
    return buffer


def _kernels(session: DeviceSession, dtype: np.dtype) -> Any:
    return session.kernels("take_mesh", {"IS_DOUBLE": int(dtype == np.float64)})


def _find_bounds(session: DeviceSession, stored: dict[str, Any], *, has_new_faces: bool) -> NDArray[np.float64] | None:
    """Return the bounds that work-items have seen, (n, 2, 3), or None if a coordinate or a face is wrong."""
    vertices, dtype, vertex_count = stored["vertices"]
    kernels, vertex_count = _kernels(session, dtype), np.int32(vertex_count)
    bounds, is_wrong = np.empty((_BOUND_ITEMS, 2, 3), dtype), np.zeros(1, np.int32)
    bounds_buffer, wrong_buffer = session.allocate(bounds.nbytes), session.allocate(4)
    session.write(wrong_buffer, is_wrong)
    session.run(
        kernels["bound_vertices"], (_BOUND_ITEMS,), _WORK_GROUP, vertices=vertices, vertex_count=vertex_count,
        bounds=bounds_buffer, is_wrong=wrong_buffer,
    )  # fmt: skip
    if has_new_faces:
        faces, _, face_count = stored["faces"]
        session.run(
            kernels["check_faces"], (face_count,), _WORK_GROUP, faces=faces, face_count=np.int32(face_count),
            vertex_count=vertex_count, is_wrong=wrong_buffer,
        )  # fmt: skip
    session.download(wrong_buffer, is_wrong)
    if is_wrong[0]:
        return None
    session.download(bounds_buffer, bounds)
    return bounds.astype(np.float64)
