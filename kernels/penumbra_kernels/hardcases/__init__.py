"""Hard cases: set-ups in which naive ray tracing code goes wrong, each with an oracle and a bound.

`penumbra selftest` runs them on a device; so do the tests. docs/numerics.md lists them with measured numbers.
"""

from penumbra_kernels.hardcases.case import HardCase, Measure, Outcome, Workbench
from penumbra_kernels.hardcases.registry import cases, certify, passed, run_case, run_cases, select

__all__ = [
    "HardCase",
    "Measure",
    "Outcome",
    "Workbench",
    "cases",
    "certify",
    "passed",
    "run_case",
    "run_cases",
    "select",
]
