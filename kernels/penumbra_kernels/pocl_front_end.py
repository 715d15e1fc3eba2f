"""What PoCL's front end is spared, where it is the one that this was measured with: half of a program's building is its work
(docs/decisions/0026-what-the-front-end-is-spared.md).

PoCL optimises every program twice: clang's front end does at `-O2`, and what comes out again, with `-O3`, at a kernel's first
launch. At `-O1` the first time takes two thirds, and the kernels are as fast. And before each program clang reads its header of
all that OpenCL C has, 18,000 lines; ours declare what they call themselves (base/library.h).
"""

from __future__ import annotations

from typing import Final

_KNOWN: Final = "PoCL 3.0"
"""The version that the wheel holds."""
_ONCE: Final = "-DPENUMBRA_OPTIMISED_ONCE=1\t-O1"
"""One word to PoCL, which checks words between spaces and knows of no `-O1`; two to clang, to which it hands on what stands
between white space of any kind."""
_NO_HEADER: Final = "-D_OPENCL_H_"
"""As if clang's header had been read already."""


def is_known(platform_version: str) -> bool:
    """Whether a platform is the PoCL that takes these options."""
    return _KNOWN in platform_version


def options(platform_version: str) -> tuple[str, ...]:
    """For every program."""
    return (_ONCE,) if is_known(platform_version) else ()


def options_of(bare: bool) -> tuple[str, ...]:
    """For one program. bare: it declares what it uses (PENUMBRA_BARE, base/library.h)."""
    return (_NO_HEADER,) if bare else ()
