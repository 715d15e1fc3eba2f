"""Assembling programs: includes, guards, flags, the generated header."""

from __future__ import annotations

import re

import numpy as np
import pytest
from penumbra_kernels import layout
from penumbra_kernels.device import BuildError, Device, DeviceError
from penumbra_kernels.program import CL_ROOT, active_lines, assemble
from penumbra_kernels.tracer import ARGUMENTS
from penumbra_kernels.warm import USUAL, features_of


def test_a_file_hidden_by_one_condition_is_there_for_another(device: Device) -> None:
    text = """
#if PENUMBRA_A
#include "base/transcendental.cl"
#endif
#include "base/math.cl"
#include "base/transcendental.cl"
__kernel void k(__global float *out) { out[0] = exp_f(0.0f) + PI_F; }
"""
    for a in (0, 1):
        program = device.build("test", {"PENUMBRA_A": a}, text)
        out = np.zeros(4, np.float32)
        buffer = device.allocate(16)
        device.launch(program.k, [buffer], 1, 1)
        device.download(buffer, out)
        assert out[0] == pytest.approx(1 + np.pi)


@pytest.mark.parametrize(
    ("text", "times"),
    [
        ("{x}\n{x}", 1),
        ("#if A\n{x}\n#if B\n{x}\n#endif\n{x}\n#endif", 1),
        ("{x}\n#if A\n{x}\n#else\n{x}\n#endif", 1),
        ("#if A\n{x}\n#else\n{x}\n#endif", 2),
        ("#if A\n{x}\n#elif B\n{x}\n#endif\n{x}", 3),
        ("#if A\n#if B\n{x}\n#endif\n{x}\n#endif\n{x}\n{x}", 3),
    ],
)
def test_a_file_is_written_again_only_where_its_first_text_may_be_compiled_away(
    text: str, times: int
) -> None:
    flat = assemble("test", {}, text.format(x='#include "base/lanes16.cl"'))
    assert flat.count("#define LANES 16u") == times
    # Whatever it includes itself goes with it.
    assert flat.count("typedef struct {\n  float3 o;") == times


def test_errors_name_our_files_and_lines(device: Device) -> None:
    with pytest.raises(BuildError, match=r"mine:2"):
        device.build("mine", {}, "\nfloat broken(;\n__kernel void k(__global float *out) {}")


@pytest.mark.parametrize("flags", [{"PENUMBRA_X": "1); evil("}, {"EVIL": 1}, {"PENUMBRA_x y": 1}])
def test_only_numbers_under_known_names_reach_a_compiler(flags: dict[str, object]) -> None:
    with pytest.raises(ValueError, match="flags are PENUMBRA_"):
        assemble("trace.cl", flags)  # type: ignore[arg-type]


def test_effects_are_gated_by_value_never_by_existence() -> None:
    for path in CL_ROOT.rglob("*.cl"):
        text = path.read_text()
        for name in re.findall(r"#\s*(?:ifdef|ifndef)\s+(\w+)", text):
            assert name == "PENUMBRA_BUILTINS", f"{path.name}: #ifdef {name}"


def test_the_committed_header_is_the_generated_one() -> None:
    assert layout.HEADER.read_text() == layout.header()


@pytest.mark.parametrize("name", layout.STRUCTS)
def test_the_device_lays_structs_out_as_the_host_does(device: Device, name: str) -> None:
    dtype = layout.STRUCTS[name]
    assert dtype.names is not None
    assert dtype.fields is not None
    offsets = "\n".join(
        f"out[{i + 1}] = (uint)((const __global char *)&s->{field} - (const __global char *)s);"
        for i, field in enumerate(dtype.names)
    )
    text = f"""
#include "layout.h"
__kernel void k(const __global {name} *s, __global uint *out) {{ out[0] = sizeof({name}); {offsets} }}
"""
    program = device.build(f"layout of {name}", {}, text)
    out = np.zeros(len(dtype.names) + 4, np.uint32)
    buffer, source = device.allocate(out.nbytes), device.allocate(dtype.itemsize)
    device.launch(program.k, [source, buffer], 1, 1)
    device.download(buffer, out)
    expected = [dtype.itemsize, *(dtype.fields[field][1] for field in dtype.names)]
    assert out[: len(expected)].tolist() == expected


def test_arguments_are_named_once() -> None:
    names = [name for name, _ in ARGUMENTS]
    assert len(names) == len(set(names))


def test_what_the_driver_refuses_is_told_as_the_devices_failure(device: Device) -> None:
    with pytest.raises(DeviceError, match=rf"{device.info.id} .*failed allocating"):
        device.allocate(1 << 50)


@pytest.mark.parametrize(
    ("condition", "holds"),
    [
        ("PENUMBRA_A", True),
        ("PENUMBRA_B", False),
        ("NOWHERE", False),
        ("!PENUMBRA_B", True),
        ("PENUMBRA_B || PENUMBRA_A && !NOWHERE", True),
        ("!(PENUMBRA_A || PENUMBRA_B)", False),
        ("PENUMBRA_A == SAMPLER_ONE && PENUMBRA_B != 1", True),
        ("defined(NOWHERE) || defined(PENUMBRA_B)", True),
        ("SAMPLER_TWO > 1 && SAMPLER_TWO <= 2", True),
        ("PENUMBRA_A == SAMPLER_UNSIGNED", True),
        ("BOTH", True),
        ("NEITHER || CALL", False),
    ],
)
def test_lines_that_flags_leave_out_are_not_counted(condition: str, holds: bool) -> None:
    text = f"""
#define SAMPLER_ONE 1
#define SAMPLER_TWO 2
#define SAMPLER_UNSIGNED 1u
#define BOTH (PENUMBRA_A == SAMPLER_UNSIGNED && !PENUMBRA_B)
#define NEITHER (PENUMBRA_B || SAMPLER_UNSIGNED > 1)
#define CALL (uint)(7 + f(x))
#if {condition} // why
int in; // a comment
#if PENUMBRA_B
int never;
#elif PENUMBRA_A
int inner;
#else
int never;
#endif
#else
/* not
a line */
int out, three;

int lines;
int here;
#endif
int always;
"""
    counted = active_lines(assemble("test.cl", {"PENUMBRA_A": 1, "PENUMBRA_B": 0}, text))
    assert counted == (3 if holds else 4)


def test_a_scenes_own_program_is_smaller_than_the_generic_one() -> None:
    def lines(flags: dict[str, int]) -> int:
        return active_lines(assemble("trace.cl", flags))

    own = [lines(features_of(effects).flags()) for effects in USUAL]
    assert 1000 < min(own) < max(own) < lines(features_of(()).generic_flags())


def test_a_condition_of_another_sort_is_refused() -> None:
    with pytest.raises(ValueError, match=r"PENUMBRA_A \+ 1"):
        active_lines("#if PENUMBRA_A + 1\n#endif\n")
