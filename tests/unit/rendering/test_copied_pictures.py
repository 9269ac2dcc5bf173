"""Pictures that are copied, or sent to another process."""

import copy
import dataclasses
import pickle

import pytest

from clbvh import Renderer, Tracer, make_shape
from clbvh.errors import DeviceError


@pytest.fixture(scope="module")
def picture(_opened_device):
    with Renderer(make_shape("icosphere", triangles=320)) as renderer:
        return renderer.render(width=16, height=12)


@pytest.mark.parametrize("duplicate", [lambda thing: pickle.loads(pickle.dumps(thing)), copy.copy, copy.deepcopy])
def test_a_picture_can_be_copied(picture, duplicate):
    copied = duplicate(picture)
    assert copied.rgb.tobytes() == picture.rgb.tobytes()
    assert copied.hits.t.tobytes() == picture.hits.t.tobytes()
    assert copied.device == picture.device
    assert copied.report()["device"] == picture.device.name
    assert pickle.dumps(copied)


def test_the_device_of_a_copied_picture_is_found_again(picture):
    device = pickle.loads(pickle.dumps(picture.device))
    with Tracer(picture.mesh, device=device) as tracer:
        assert tracer.any_hit([0, 0, 5], [0, 0, -1])
        assert tracer.device.cl_device == picture.device.cl_device


def test_a_device_of_another_machine(picture):
    device = dataclasses.replace(picture.device, name="Imagined", cl_device=None)
    with pytest.raises(DeviceError, match=r"the device 'Imagined' .* is not here"):
        Tracer(picture.mesh, device=device)
