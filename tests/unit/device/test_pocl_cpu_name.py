"""A device of PoCL that does not know its processor is given a name; all other devices are left alone."""

import ctypes
import struct
import sys
from types import SimpleNamespace

import pytest

from clbvh.device.pocl_cpu_name import choose_name, name_unknown_cpu

ZEN_5 = "OpenCL 3.0 PoCL HSTR: pthread-x86_64-unknown-linux-gnu-generic"

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="the processor is named on Linux only")


def make_device(record, *, version=ZEN_5, driver_version="3.0-rc2"):
    """Return what is read of a device, with the address of a record in memory such as PoCL has."""
    handle = SimpleNamespace(int_ptr=record)
    return SimpleNamespace(version=version, driver_version=driver_version, cl_device=handle)


@pytest.fixture
def word():
    return ctypes.create_string_buffer(b"generic", 16)


def make_record(*pointers):
    """Return a record of 2 KiB with pointers at odd places, and numbers that are no addresses elsewhere."""
    fields = [7, 2**64 - 1, 0, 4096] * 64
    for place, pointer in enumerate(pointers):
        fields[80 + 3 * place] = pointer
    return ctypes.create_string_buffer(struct.pack("<256Q", *fields), 2048)


def test_the_word_is_replaced_by_a_name_that_fits(word):
    record = make_record(ctypes.addressof(word))
    before = record.raw
    name_unknown_cpu(make_device(ctypes.addressof(record)))
    assert word.value in (b"skx", b"haswell", b"x86-64")
    assert word.raw[8:] == bytes(8)
    assert record.raw == before


@pytest.mark.parametrize(
    "changes",
    [
        {"version": "OpenCL 3.0 PoCL HSTR: pthread-x86_64-unknown-linux-gnu-znver3"},
        {"version": "OpenCL 3.0 PoCL HSTR: cpu-x86_64-pc-linux-gnu-generic", "driver_version": "6.0"},
        {"version": "OpenCL 3.0 CUDA", "driver_version": "550.54"},
        {"version": "", "driver_version": "3.0"},
    ],
)
def test_other_devices_are_left_alone(word, changes):
    record = make_record(ctypes.addressof(word))
    name_unknown_cpu(make_device(ctypes.addressof(record), **changes))
    assert word.value == b"generic"


def test_two_pointers_to_such_words_are_left_alone(word):
    other = ctypes.create_string_buffer(b"generic", 16)
    record = make_record(ctypes.addressof(word), ctypes.addressof(other))
    name_unknown_cpu(make_device(ctypes.addressof(record)))
    assert word.value == other.value == b"generic"


def test_a_record_without_the_word_or_without_memory_is_left_alone():
    name_unknown_cpu(make_device(ctypes.addressof(make_record())))
    name_unknown_cpu(make_device(8))


AVX2 = "avx2 bmi1 bmi2 f16c fma abm movbe rdrand"
AVX512 = "avx512f avx512bw avx512cd avx512dq avx512vl adx rdseed xsavec xsaves"


@pytest.mark.parametrize(
    ("flags", "name"),
    [
        (f"{AVX2} {AVX512} sse2", b"skx"),
        (f"{AVX2} {AVX512}".replace("avx512vl", ""), b"haswell"),
        (AVX512, b"x86-64"),
        (AVX2, b"haswell"),
        (AVX2.replace("fma", ""), b"x86-64"),
        ("", b"x86-64"),
    ],
)
def test_the_name_promises_no_more_than_the_processor_has(flags, name):
    padded = choose_name(set(flags.split()))
    assert len(padded) == 7
    assert padded.rstrip(b"\0") == name
