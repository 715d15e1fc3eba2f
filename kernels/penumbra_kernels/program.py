"""Assembling a program's text: the prologue of 0/1 flags, then the sources flattened with `#line` kept."""

from __future__ import annotations

import ast
import hashlib
import operator
import re
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Final

from penumbra_kernels.layout import CONSTANTS

CL_ROOT: Final = Path(__file__).parent / "cl"

_BRANCH_BEGINS: Final = re.compile(r"\s*#\s*(if|el)")
_BRANCH_ENDS: Final = re.compile(r"\s*#\s*e(l|ndif)")
_INCLUDE: Final = re.compile(r'^\s*#include\s+"([^"]+)"\s*$')

BUILD_OPTIONS: Final = ("-cl-std=CL1.2",)
"""The same for every program. No fast-math of any kind: error bounds and equal bits depend on IEEE arithmetic."""


LANES_ALONE: Final = ("PENUMBRA_TOGETHER", "PENUMBRA_LARGE_TREES")
"""Flags that say something to lanes of sixteen paths alone (trace.cl, PENUMBRA_LANES)."""


def settle(flags: Mapping[str, int]) -> dict[str, int]:
    """The flags of a program, those that nothing in it reads being 0: programs of the same code then are the same program."""
    apart = ("PENUMBRA_DEVICE_GPU", "PENUMBRA_COMPACT_TREE")
    lanes = flags.get("PENUMBRA_TOGETHER") and not any(flags.get(name) for name in apart)
    if lanes and flags.get("PENUMBRA_SAMPLER") != CONSTANTS["SAMPLER_RANDOM"]:
        return dict(flags)
    return {name: 0 if name in LANES_ALONE else value for name, value in flags.items()}


def flatten(text: str, name: str, blocks: list[set[str]]) -> str:
    """Inline every `#include "path"` (relative to cl/), keeping file names and lines for error messages.

    blocks: the files whose text stands in each of the #if blocks around this text, the outermost first. Such a file is not
    written again; one that stands in a block that has ended is, under a guard, since its first text may be compiled away.
    """
    out = [f'#line 1 "{name}"']
    for number, line in enumerate(text.splitlines(), start=1):
        if not line.lstrip().startswith("#"):
            out.append(line)
        elif match := _INCLUDE.match(line):
            out.append(_included(match.group(1), blocks))
            out.append(f'#line {number + 1} "{name}"')
        else:
            if _BRANCH_ENDS.match(line):
                blocks.pop()
            if _BRANCH_BEGINS.match(line):
                blocks.append(set())
            out.append(line)
    return "\n".join(out)


def _included(path: str, blocks: list[set[str]]) -> str:
    if any(path in block for block in blocks):
        return ""
    blocks[-1].add(path)
    guard = "PENUMBRA_HAS_" + re.sub(r"\W", "_", path).upper()
    # The guard is no block of its own: where it leaves this text out, all that stands in it stands before.
    text = flatten((CL_ROOT / path).read_text(), path, blocks)
    return f"#if !{guard}\n#define {guard} 1\n{text}\n#endif"


def assemble(entry: str, flags: Mapping[str, int], text: str | None = None) -> str:
    """The whole text of a program.

    entry: file under cl/ that holds the kernels, or, where `text` is given, a name for that text.
    flags: macro name -> integer; numbers only, so that no text of a user ever reaches a compiler.
    """
    for key, value in flags.items():
        if not re.fullmatch(r"PENUMBRA_[A-Z0-9_]+", key) or not isinstance(value, int):
            raise ValueError(f"flag {key}={value!r}: flags are PENUMBRA_* macros with integer values")
    prologue = "".join(f"#define {key} {int(value)}\n" for key, value in sorted(flags.items()))
    body = _entry(entry) if text is None else flatten(text, entry, [{entry}])
    return prologue + "#pragma OPENCL FP_CONTRACT OFF\n" + body


@cache
def _entry(name: str) -> str:
    """A file under cl/, flattened. Once: a program's text is asked for several times, by its key and to build it."""
    return flatten((CL_ROOT / name).read_text(), name, [{name}])


_DEFINE: Final = re.compile(r"^\s*#\s*define\s+(\w+)(?:\s+(\w+|\(.*\)))?\s*$")
_INTEGER: Final = re.compile(r"(\d+)[uUlL]*")
_CONDITION: Final = re.compile(r"^\s*#\s*(if|ifdef|ifndef|elif|else|endif)\b(.*)")
_COMMENT: Final = re.compile(r"/\*.*?\*/", re.DOTALL)
_COMPARISONS: Final[dict[type, Callable[[int, int], bool]]] = {
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
}


def active_lines(source: str) -> int:
    """Lines of an assembled text that its flags leave in, without comments and directives: what a compiler has to read.

    Conditions are those that this project writes: integers, macros, comparisons, &&, || and !. A macro that the text does
    not define, with a number or with such a condition in parentheses, is 0, as OpenCL C has it (C99, 6.10.1); what a compiler
    predefines is unknown here.
    """
    macros: dict[str, int] = {}
    blocks: list[tuple[bool, bool]] = []  # (this branch is in, some branch of the block was)
    count, active = 0, True
    for line in map(str.strip, _COMMENT.sub("", source).splitlines()):
        if not line.startswith("#"):
            count += active and bool(line) and not line.startswith("//")
        elif condition := _CONDITION.match(line):
            _enter(blocks, condition.group(1), condition.group(2), macros)
            active = all(branch for branch, _ in blocks)
        elif active and (define := _DEFINE.match(line)):
            macros[define.group(1)] = _number(define.group(2) or "", macros)
    return count


def _enter(blocks: list[tuple[bool, bool]], word: str, rest: str, macros: Mapping[str, int]) -> None:
    """Follow one directive into, through or out of its block."""
    if word == "endif":
        blocks.pop()
        return
    if word in ("elif", "else"):
        _, taken = blocks.pop()
        active = not taken and (word == "else" or _holds(rest, macros))
    else:
        taken = False
        known = rest.split("//")[0].strip() in macros
        active = {"ifdef": known, "ifndef": not known}[word] if word != "if" else _holds(rest, macros)
    blocks.append((active, taken or active))


def _number(text: str, macros: Mapping[str, int]) -> int:
    """Of a macro: an integer, or a condition in parentheses; 0 where it is neither."""
    integer = _INTEGER.fullmatch(text)
    if integer:
        return int(integer.group(1))
    try:
        return int(_holds(text, macros)) if text.startswith("(") else 0
    except (SyntaxError, ValueError):
        return 0


def _holds(condition: str, macros: Mapping[str, int]) -> bool:
    words = condition.split("//")[0]
    if "defined" in words:
        words = re.sub(r"defined\s*\(?\s*(\w+)\s*\)?", lambda m: str(int(m[1] in macros)), words)
    return bool(_value(_parsed(words), macros))


@cache
def _parsed(condition: str) -> ast.expr:
    """The same few conditions stand in every program."""
    words = re.sub(r"!(?!=)", " not ", condition.replace("&&", " and ").replace("||", " or "))
    return ast.parse(words.strip(), mode="eval").body


def _value(node: ast.expr, macros: Mapping[str, int]) -> int:
    match node:
        case ast.Constant(value=int(number)):
            return number
        case ast.Name(id=name):
            return macros.get(name, 0)
        case ast.UnaryOp(op=ast.Not(), operand=inner):
            return int(not _value(inner, macros))
        case ast.BoolOp(op=ast.And(), values=parts):
            return int(all(_value(part, macros) for part in parts))
        case ast.BoolOp(op=ast.Or(), values=parts):
            return int(any(_value(part, macros) for part in parts))
        case ast.Compare(left=left, ops=[compare], comparators=[right]):
            return int(_COMPARISONS[type(compare)](_value(left, macros), _value(right, macros)))
    raise ValueError(f"a condition that is not read here: {ast.unparse(node)}")


def source_hash(source: str) -> str:
    """SHA-256 of a program's text, hexadecimal."""
    return hashlib.sha256(source.encode()).hexdigest()
