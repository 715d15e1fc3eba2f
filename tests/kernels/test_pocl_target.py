"""Naming PoCL's target where its LLVM does not know the processor: found by its neighbour, or left alone."""

from __future__ import annotations

import ctypes

import pytest
from penumbra_kernels.device import Device, devices
from penumbra_kernels.pocl_target import Reader, find_unknown, name_target, target_for

SKYLAKE = {"avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl", "avx2", "fma"}
ICELAKE = SKYLAKE | {
    "avx512ifma", "avx512vbmi", "avx512_vbmi2", "avx512_bitalg", "avx512_vnni", "avx512_vpopcntdq",
    "gfni", "vaes", "vpclmulqdq", "sha_ni",
}  # fmt: skip


def record(*texts: bytes | None) -> tuple[ctypes.Array[ctypes.c_uint64], list[object]]:
    """A record of pointers to the texts, None for a word that points nowhere; and what keeps the texts alive."""
    kept = [ctypes.create_string_buffer(text) if text is not None else None for text in texts]
    words = [ctypes.addressof(text) if text is not None else 0x10 for text in kept]
    return (ctypes.c_uint64 * 128)(*words), list(kept)


@pytest.fixture
def reader():
    opened = Reader()
    yield opened
    opened.close()


def test_the_name_behind_the_triple_is_found(reader: Reader) -> None:
    words, _kept = record(b"pthread", None, b"x86_64-unknown-linux-gnu", b"generic", b"other")
    assert find_unknown(bytes(words), reader) == 24


@pytest.mark.parametrize(
    "texts",
    [
        (b"generic", b"x86_64-unknown-linux-gnu"),
        (b"x86_64-unknown-linux-gnu", b"znver3"),
        (b"aarch64-unknown-linux-gnu", b"generic"),
        (b"x86_64-unknown-linux-gnu", b"generic", b"x86_64-unknown-linux-gnu", b"generic"),
        (None, None),
    ],
    ids=["order", "known", "machine", "twice", "nothing"],
)
def test_a_record_of_another_shape_is_left_alone(reader: Reader, texts: tuple[bytes | None, ...]) -> None:
    words, _kept = record(*texts)
    assert find_unknown(bytes(words), reader) is None
    before = bytes(words)
    assert name_target(ctypes.addressof(words)) is None
    assert bytes(words) == before


def test_a_record_gets_a_name_that_llvm_knows() -> None:
    words, _kept = record(b"x86_64-pc-linux-gnu", b"generic")
    name = name_target(ctypes.addressof(words))
    assert name is not None
    assert ctypes.string_at(words[1]) == name.encode()
    assert name_target(ctypes.addressof(words)) == name, "a second look tells the same"


@pytest.mark.parametrize(
    ("features", "target"),
    [
        (ICELAKE, "icelake-server"),
        (ICELAKE - {"gfni"}, "skylake-avx512"),
        (SKYLAKE, "skylake-avx512"),
        (SKYLAKE - {"avx512dq"}, "x86-64"),
        ({"avx2", "fma", "bmi1", "bmi2", "f16c", "movbe", "avx512f"}, "haswell"),
        (set(), "x86-64"),
    ],
)
def test_the_target_is_the_most_able_one_that_the_processor_has(features: set[str], target: str) -> None:
    assert target_for(features) == target


def test_no_device_compiles_for_an_unknown_processor(device: Device) -> None:
    assert device.info.target != "generic"
    assert [info.target for info in devices() if info.id == device.info.id] == [device.info.target]
